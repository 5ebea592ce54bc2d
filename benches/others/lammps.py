#!/usr/bin/env python3
"""LAMMPS `gran/hooke/history` on a packing of benches/packings, held between six walls (Debian: lammps).

    python3 benches/others/lammps.py benches/packings/dense-5000.csv 0.075326733 0.074770267 0.074783642 2000

Prints nanoseconds per contact and step of one process, beside `porograin bench dry` on the same packing. Development only.
"""
import re
import subprocess
import sys
import tempfile

import numpy as np

path, lx, ly, lz, steps = sys.argv[1], *map(float, sys.argv[2:5]), int(sys.argv[5])
x, y, z, r = np.loadtxt(path, delimiter=",", comments="#", unpack=True)
kn = 15e6 * r.mean()
mass = 2600 * 4 / 3 * np.pi * r.mean() ** 3
dt = 0.2 * (mass / kn) ** 0.5
folder = tempfile.mkdtemp()
with open(f"{folder}/data", "w") as f:
    f.write(f"grains\n\n{len(r)} atoms\n1 atom types\n0 {lx} xlo xhi\n0 {ly} ylo yhi\n0 {lz} zlo zhi\n\nAtoms # sphere\n\n")
    for k in range(len(r)):
        f.write(f"{k + 1} 1 {2 * r[k]} 2600 {x[k]} {y[k]} {z[k]}\n")
law = f"{kn} {0.5 * kn} 5.0 5.0 0.577 1"
walls = "\n".join(
    f"fix w{axis} all wall/gran hooke/history {law} {axis}plane 0 {length}"
    for axis, length in zip("xyz", (lx, ly, lz))
)
with open(f"{folder}/in", "w") as f:
    f.write(f"""units si
atom_style sphere
boundary f f f
newton off
comm_modify vel yes
read_data {folder}/data
pair_style gran/hooke/history {law}
pair_coeff * *
neighbor {0.15 * r.mean()} bin
neigh_modify delay 0 every 1 check yes
timestep {dt}
fix move all nve/sphere
{walls}
compute touching all contact/atom
compute all_touching all reduce sum c_touching
thermo_style custom step ke c_all_touching
thermo {steps}
run {steps // 10}
run {steps}
""")
out = subprocess.run(["lmp", "-in", f"{folder}/in", "-log", "none"], capture_output=True, text=True).stdout
loops = re.findall(r"Loop time of ([0-9.e+-]+) on 1 procs for (\d+) steps", out)
if not loops:
    sys.exit(out)
seconds, ran = float(loops[-1][0]), int(loops[-1][1])
contacts = float([l for l in out.splitlines() if re.match(r"\s+\d+\s+\S+\s+\S+\s*$", l)][-1].split()[2]) / 2
if "-v" in sys.argv:
    print(out)
print(f"LAMMPS: {1e9 * seconds / ran / contacts:.1f} ns per contact and step, {contacts:.0f} contacts between grains, {ran} steps")
