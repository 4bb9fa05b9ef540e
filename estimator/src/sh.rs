//! Real orthonormal spherical harmonics.
