//! `cargo +nightly fuzz run triangulation` in crates/geometry: any bytes as a cell and grains; never a panic or a hang.
#![no_main]

use glam::{DMat3, DVec3};
use libfuzzer_sys::fuzz_target;
use porograin_geometry::{Cell, Triangulation};

/// Eight bytes as a coordinate: raw bits, or a small whole number of quarters so that ties are found quickly.
fn number(bytes: &[u8]) -> f64 {
    let mut word = [0; 8];
    word[..bytes.len()].copy_from_slice(bytes);
    let bits = u64::from_le_bytes(word);
    if bits & 1 == 0 { ((bits >> 1) & 7) as f64 / 4.0 } else { f64::from_bits(bits) }
}

fuzz_target!(|data: &[u8]| {
    let Some((&flags, data)) = data.split_first() else { return };
    let mut numbers = data.chunks(8).map(number);
    let mut next = || numbers.next();
    let periodic = [flags & 1 != 0, flags & 2 != 0, flags & 4 != 0];
    let mut cell = Cell { periodic, ..Cell::walled(DVec3::ZERO, DVec3::splat(2.0)) };
    if flags & 8 != 0 {
        let mut edges = [0.0; 9];
        edges.iter_mut().for_each(|e| *e = next().unwrap_or(1.0));
        cell.edges = DMat3::from_cols_array(&edges);
    }
    let (mut x, mut r) = (Vec::new(), Vec::new());
    while let (Some(a), Some(b), Some(c), Some(d)) = (next(), next(), next(), next()) {
        x.push(DVec3::new(a, b, c));
        r.push(d);
        if x.len() == 200 {
            break;
        }
    }
    let Ok(mut t) = Triangulation::new(&cell, &x, &r) else { return };
    // Move some, follow, compare.
    x.iter_mut().step_by(3).for_each(|p| p.x = 2.0 - p.x);
    if t.repair(&cell, &x, &r).is_ok() {
        assert!(t == Triangulation::new(&cell, &x, &r).expect("repair accepted it"));
    }
});
