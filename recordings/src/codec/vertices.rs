//! The vertices of a result, quantised: position 3 × 16 bits in the bounding box, normal 2 × 12 bits (octahedral), lit
//! colour 3 × 15 bits (half floats), albedo 3 × 12 bits (logarithmic), segment 16 bits, confidence 8 bits; 22.5 bytes
//! at worst, less where neighbours are alike. Arrays stand in the order of the traversal of `connectivity`.

use crate::codec::connectivity;
use crate::codec::header::{from_bytes, to_bytes};
use crate::codec::pack::{Input, put_bytes, put_numbers, put_varint, take_bytes, take_numbers};
use crate::result::estimate::Estimate;
use crate::v1::VerticesV1;
use glam::Vec3;
use half::f16;

const POSITION_BITS: u32 = 16;
const NORMAL_BITS: u32 = 12;
/// Even, so that the axes are met exactly.
const NORMAL_TOP: f32 = 4094.0;
const LIT_BITS: u32 = 15;
const ALBEDO_BITS: u32 = 12;
const SEGMENT_BITS: u32 = 16;
/// The largest lit colour is stored as this half float, so that six decades below it are still normal numbers.
const LIT_TOP: f32 = 32_768.0;
/// Decades of albedo below the largest; what is smaller is stored as 0.
const ALBEDO_DECADES: f64 = 5.0;

/// The vertex arrays of a result.
pub(crate) struct Vertices {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub segment: Vec<u32>,
    pub lit_color: Vec<Vec3>,
    pub albedo: Vec<Vec3>,
    pub confidence: Vec<f32>,
}

/// Packs triangle codes and the traversal's order of the vertices.
pub(crate) fn pack_triangles(codes: &[u8], triangles: usize, order: &[u32]) -> Vec<u8> {
    let mut out = Vec::new();
    put_varint(&mut out, triangles as u32);
    put_varint(&mut out, codes.len() as u32);
    put_bytes(&mut out, codes);
    put_varint(&mut out, order.len() as u32);
    // As few bits as the largest index needs: the order of a shuffled mesh has no pattern.
    let bits = index_bits(order.len());
    let (mut bytes, mut buffer, mut filled) = (Vec::new(), 0u64, 0);
    for index in order {
        buffer |= u64::from(*index) << filled;
        filled += bits;
        while filled >= 8 {
            bytes.push(buffer as u8);
            buffer >>= 8;
            filled -= 8;
        }
    }
    if filled > 0 {
        bytes.push(buffer as u8);
    }
    out.extend(bytes);
    out
}

fn index_bits(n: usize) -> u32 {
    usize::BITS - n.saturating_sub(1).leading_zeros()
}

/// Triangles in the vertices' own order, and the order of the traversal.
pub(crate) fn unpack_triangles(bytes: &[u8]) -> Result<(Vec<[u32; 3]>, Vec<u32>), String> {
    let mut input = Input(bytes);
    let triangles = input.varint()? as usize;
    let length = input.varint()? as usize;
    let codes = take_bytes(&mut input, length)?;
    let vertices = input.varint()?;
    let bits = index_bits(vertices as usize);
    let packed = input.take((vertices as usize * bits as usize).div_ceil(8))?;
    if bits == 0 && vertices > 1 {
        return Err("no order of vertices".into());
    }
    let mut order = Vec::with_capacity(vertices as usize);
    let mut seen = vec![false; vertices as usize];
    let (mut buffer, mut filled, mut bytes) = (0u64, 0, packed.iter());
    for _ in 0..vertices {
        while filled < bits {
            buffer |= u64::from(*bytes.next().ok_or("the order of vertices ends early")?) << filled;
            filled += 8;
        }
        let index = (buffer & ((1 << bits) - 1)) as u32;
        buffer >>= bits;
        filled -= bits;
        match seen.get_mut(index as usize) {
            Some(seen) if !*seen => *seen = true,
            _ => return Err("the order of vertices is no permutation".into()),
        }
        order.push(index);
    }
    let mut triangles = connectivity::decode(&codes, vertices, triangles)?;
    triangles.iter_mut().flatten().for_each(|v| *v = order[*v as usize]);
    Ok((triangles, order))
}

/// Packs the vertex arrays in `order`.
pub(crate) fn pack(estimate: &Estimate, order: &[u32]) -> Result<Vec<u8>, String> {
    let positions = &estimate.mesh.positions;
    let low = positions.iter().copied().reduce(Vec3::min).unwrap_or_default();
    let high = positions.iter().copied().reduce(Vec3::max).unwrap_or_default();
    let largest = |colors: &[Vec3]| colors.iter().map(|c| c.max_element()).fold(0.0, f32::max);
    let head = VerticesV1 {
        vertices: positions.len() as u32,
        low: low.to_array(),
        high: high.to_array(),
        has_normals: !estimate.mesh.normals.is_empty(),
        lit_scale: largest(&estimate.lit_color),
        albedo_scale: largest(&estimate.albedo),
    };
    let mut out = to_bytes(&head)?;
    let mut put = |bits: u32, code: &dyn Fn(usize) -> u16| {
        let values: Vec<u16> = order.iter().map(|v| code(*v as usize)).collect();
        put_numbers(&mut out, &values, bits);
    };
    for axis in 0..3 {
        put(POSITION_BITS, &|v| encode_position(positions[v][axis], low[axis], high[axis]));
    }
    if head.has_normals {
        let codes: Vec<[u16; 2]> = estimate.mesh.normals.iter().map(|n| encode_normal(*n)).collect();
        put(NORMAL_BITS, &|v| codes[v][0]);
        put(NORMAL_BITS, &|v| codes[v][1]);
    }
    let lit: Vec<[u16; 3]> =
        estimate.lit_color.iter().map(|c| decorrelate(c.to_array().map(|x| encode_lit(x, head.lit_scale)))).collect();
    let albedo: Vec<[u16; 3]> = estimate
        .albedo
        .iter()
        .map(|c| decorrelate(c.to_array().map(|x| encode_albedo(x, head.albedo_scale))))
        .collect();
    for (codes, bits) in [(lit, LIT_BITS), (albedo, ALBEDO_BITS)] {
        (0..3).for_each(|channel| put(bits, &|v| codes[v][channel] & (u16::MAX >> (16 - bits))));
    }
    put(SEGMENT_BITS, &|v| estimate.segment[v] as u16);
    put(SEGMENT_BITS, &|v| (estimate.segment[v] >> 16) as u16);
    let confidence = order.iter().map(|v| (255.0 * estimate.confidence[*v as usize].clamp(0.0, 1.0)).round() as u8);
    put_bytes(&mut out, &confidence.collect::<Vec<u8>>());
    Ok(out)
}

/// Unpacks the vertex arrays into the vertices' own order.
pub(crate) fn unpack(bytes: &[u8], order: &[u32]) -> Result<Vertices, String> {
    let (head, rest) = from_bytes::<VerticesV1>(bytes)?;
    let n = order.len();
    let numbers = [head.low, head.high, [head.lit_scale, head.albedo_scale, 0.0]];
    if head.vertices as usize != n || !numbers.iter().flatten().all(|x| x.is_finite()) {
        return Err("the vertices' header makes no sense".into());
    }
    let mut input = Input(rest);
    let mut place = vec![0; n];
    order.iter().enumerate().for_each(|(number, v)| place[*v as usize] = number);
    let mut take = |bits: u32| -> Result<Vec<u16>, String> {
        let codes = take_numbers(&mut input, n, bits)?;
        Ok(place.iter().map(|number| codes[*number]).collect())
    };
    let axes = [take(POSITION_BITS)?, take(POSITION_BITS)?, take(POSITION_BITS)?];
    let position = |v: usize| [0, 1, 2].map(|k| decode_position(axes[k][v], head.low[k], head.high[k]));
    let positions = (0..n).map(|v| Vec3::from_array(position(v))).collect();
    let normals = if head.has_normals {
        take(NORMAL_BITS)?.into_iter().zip(take(NORMAL_BITS)?).map(|(a, b)| decode_normal([a, b])).collect()
    } else {
        Vec::new()
    };
    let mut colors = |bits: u32, decode: &dyn Fn(u16) -> f32| -> Result<Vec<Vec3>, String> {
        let mask = u16::MAX >> (16 - bits);
        let channels = [take(bits)?, take(bits)?, take(bits)?];
        let color = |v: usize| correlate([0, 1, 2].map(|k| channels[k][v])).map(|code| decode(code & mask));
        Ok((0..n).map(|v| Vec3::from_array(color(v))).collect())
    };
    let lit_color = colors(LIT_BITS, &|code| decode_lit(code, head.lit_scale))?;
    let albedo = colors(ALBEDO_BITS, &|code| decode_albedo(code, head.albedo_scale))?;
    let segment = take(SEGMENT_BITS)?.into_iter().zip(take(SEGMENT_BITS)?);
    let segment = segment.map(|(low, high)| u32::from(low) | u32::from(high) << 16).collect();
    let confidence = take_bytes(&mut input, n)?;
    let confidence = place.iter().map(|number| f32::from(confidence[*number]) / 255.0).collect();
    Ok(Vertices { positions, normals, segment, lit_color, albedo, confidence })
}

fn encode_position(x: f32, low: f32, high: f32) -> u16 {
    let extent = f64::from(high) - f64::from(low);
    if extent > 0.0 { ((f64::from(x) - f64::from(low)) / extent * 65535.0).round() as u16 } else { 0 }
}

fn decode_position(code: u16, low: f32, high: f32) -> f32 {
    (f64::from(low) + (f64::from(high) - f64::from(low)) * f64::from(code) / 65535.0) as f32
}

/// Octahedral: the unit sphere projected to the octahedron |x|+|y|+|z| = 1, its lower half folded out into a square.
fn encode_normal(n: Vec3) -> [u16; 2] {
    let sum = n.x.abs() + n.y.abs() + n.z.abs();
    if sum == 0.0 {
        return encode_normal(Vec3::Z);
    }
    let (x, y) = (n.x / sum, n.y / sum);
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    let (x, y) = if n.z < 0.0 { ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)) } else { (x, y) };
    [x, y].map(|v| ((v + 1.0) / 2.0 * NORMAL_TOP).round() as u16)
}

fn decode_normal(code: [u16; 2]) -> Vec3 {
    let [x, y] = code.map(|c| f32::from(c) / NORMAL_TOP * 2.0 - 1.0);
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let toward_zero = |v: f32| if v < 0.0 { v + fold } else { v - fold };
    Vec3::new(toward_zero(x), toward_zero(y), z).normalize_or(Vec3::Z)
}

/// Channels differ less from green than from zero. Modulo 2^16; the caller cuts to its bits.
fn decorrelate([r, g, b]: [u16; 3]) -> [u16; 3] {
    [g, r.wrapping_sub(g), b.wrapping_sub(g)]
}

fn correlate([g, r, b]: [u16; 3]) -> [u16; 3] {
    [r.wrapping_add(g), g, b.wrapping_add(g)]
}

fn encode_lit(x: f32, scale: f32) -> u16 {
    if x > 0.0 { f16::from_f32((f64::from(x) / f64::from(scale) * f64::from(LIT_TOP)) as f32).to_bits() } else { 0 }
}

fn decode_lit(code: u16, scale: f32) -> f32 {
    let x = f16::from_bits(code).to_f64() / f64::from(LIT_TOP) * f64::from(scale);
    if x.is_finite() { x as f32 } else { 0.0 }
}

fn encode_albedo(x: f32, scale: f32) -> u16 {
    if x <= 0.0 {
        return 0;
    }
    let below = libm::log10(f64::from(x) / f64::from(scale)) / ALBEDO_DECADES;
    let top = f64::from((1u16 << ALBEDO_BITS) - 2);
    if below < -1.0 { 0 } else { 1 + ((1.0 + below) * top).round() as u16 }
}

fn decode_albedo(code: u16, scale: f32) -> f32 {
    if code == 0 {
        return 0.0;
    }
    let top = f64::from((1u16 << ALBEDO_BITS) - 2);
    (f64::from(scale) * libm::pow(10.0, (f64::from(code - 1) / top - 1.0) * ALBEDO_DECADES)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn positions_keep_to_a_step_of_the_box(x in -5.0f32..5.0) {
            let back = decode_position(encode_position(x, -5.0, 5.0), -5.0, 5.0);
            prop_assert!((x - back).abs() <= 10.0 / 65535.0 * 0.501);
        }

        #[test]
        fn normals_keep_to_a_fifteenth_of_a_degree(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0) {
            let n = Vec3::new(x, y, z);
            prop_assume!(n.length() > 0.01);
            let back = decode_normal(encode_normal(n.normalize()));
            prop_assert!(back.cross(n.normalize()).length() < (1.0f32 / 15.0).to_radians() && back.dot(n) > 0.0);
        }

        #[test]
        fn colours_keep_to_a_small_share_of_themselves(exponent in -5.0f64..0.0, scale in -10.0f64..10.0) {
            let scale = libm::pow(10.0, scale);
            let x = (libm::pow(10.0, exponent) * scale) as f32;
            let lit = decode_lit(encode_lit(x, scale as f32), scale as f32);
            prop_assert!((lit / x - 1.0).abs() < 0.0005, "{x} {lit}");
            let albedo = decode_albedo(encode_albedo(x, scale as f32), scale as f32);
            prop_assert!((albedo / x - 1.0).abs() < 0.0015 || exponent < -4.999, "{x} {albedo}");
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = unpack_triangles(&bytes);
            let _ = unpack(&bytes, &[2, 0, 1]);
        }
    }

    #[test]
    fn black_and_degenerate_values_stay() {
        assert_eq!(decode_lit(encode_lit(0.0, 0.0), 0.0), 0.0);
        assert_eq!(decode_lit(encode_lit(-3.0, 1.0), 1.0), 0.0);
        assert_eq!(decode_albedo(encode_albedo(0.0, 0.0), 0.0), 0.0);
        assert_eq!(decode_albedo(encode_albedo(0.7, 0.7), 0.7), 0.7);
        assert_eq!(decode_position(encode_position(2.0, 2.0, 2.0), 2.0, 2.0), 2.0);
        assert_eq!(decode_normal(encode_normal(Vec3::ZERO)), Vec3::Z);
    }
}
