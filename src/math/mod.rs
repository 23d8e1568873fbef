//! Ground that every stage may stand on: boxes and repeatable random numbers. Names no stage.

mod aabb;

mod hash;

pub use aabb::Aabb;
pub use hash::{hash, unit_pair};
