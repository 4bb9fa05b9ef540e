//! Mathematics that knows no scene: real spherical harmonics ([`sh`]), robust statistics ([`robust`]) and seeded
//! random directions ([`random`]).

pub mod random;
pub mod robust;
pub mod sh;
