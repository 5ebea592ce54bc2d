//! The examples run, and what they assert holds.

#[path = "../examples/packing.rs"]
mod packing;
#[path = "../examples/sensors.rs"]
mod sensors;
#[path = "../examples/shear.rs"]
mod shear;

#[test]
fn examples_run() {
    packing::main();
    sensors::main();
    shear::main();
}
