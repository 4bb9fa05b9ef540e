//! Data association: lit colours from posed keyframes (Eqs. 2–4).
