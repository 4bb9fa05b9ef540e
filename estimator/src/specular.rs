//! Specular weights per segment (Eq. 13).
