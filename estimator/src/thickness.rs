//! Shape diameter (the sdf of Eq. 6).
