//! Radiance transfer (Eq. 8).
