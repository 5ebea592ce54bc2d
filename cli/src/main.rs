//! The porograin command.
fn main() {}
