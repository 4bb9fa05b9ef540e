//! Mathematics independent of scenes: real spherical harmonics ([`sh`]), products of matrices ([`dense`]), robust
//! statistics ([`robust`]), seeded random directions ([`random`]), rotations ([`rotation`]), means over channels ([`channels`]),
//! lists by key ([`lists`]) and CIELAB ([`cielab`]).

pub mod channels;
pub mod cielab;
pub mod dense;
pub mod lists;
pub mod random;
pub mod robust;
pub mod rotation;
pub mod sh;
