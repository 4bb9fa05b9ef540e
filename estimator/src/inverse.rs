//! Light and segment albedo from lit colours (Eqs. 9–12).
