"""Yade's linear law on a packing of benches/packings, held between six walls (Debian: yade).

    yade -j1 -n -x benches/others/yade_dry.py benches/packings/dense-5000.csv 0.075326733 0.074770267 0.074783642 500

Prints nanoseconds per contact and step, beside `porograin bench dry` on the same packing. Development only.
"""
import sys
import time

from yade import O, utils
from yade.wrapper import *

path, sides, steps = sys.argv[1], [float(a) for a in sys.argv[2:5]], int(sys.argv[5])
O.materials.append(FrictMat(young=15e6, poisson=0.5, frictionAngle=0.52, density=2600))
O.bodies.append(utils.aabbWalls([(0, 0, 0), tuple(sides)], thickness=0))
for line in open(path):
    if not line.startswith("#"):
        x, y, z, r = (float(c) for c in line.split(","))
        O.bodies.append(utils.sphere((x, y, z), r))
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Box_Aabb()], verletDist=-0.15),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom(), Ig2_Box_Sphere_ScGeom()],
        [Ip2_FrictMat_FrictMat_FrictPhys()],
        [Law2_ScGeom_FrictPhys_CundallStrack()],
    ),
    NewtonIntegrator(damping=0.2),
]
O.dt = 0.5 * utils.PWaveTimeStep()
O.run(steps // 10, True)
start = time.time()
O.run(steps, True)
spent = time.time() - start
contacts = O.interactions.countReal()
print("Yade: %.1f ns per contact and step, %d contacts, %d steps" % (1e9 * spent / steps / contacts, contacts, steps))
