//! Mathematics independent of scenes: real spherical harmonics ([`sh`]), products of matrices ([`dense`]), robust
//! statistics ([`robust`]), seeded random directions ([`random`]), rotations ([`rotation`]), means over channels ([`channels`])
//! and CIELAB ([`cielab`]).

pub mod channels;
pub mod cielab;
pub mod dense;
pub mod random;
pub mod robust;
pub mod rotation;
pub mod sh;
