//! Exposure per keyframe (Eq. 5).
