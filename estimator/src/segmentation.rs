//! Segmentation into materials (Eqs. 6–7).
