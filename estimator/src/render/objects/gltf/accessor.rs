//! Typed rows of glTF accessors: every component type, interleaved, normalised and sparse.

use super::resources::view_bytes;
use ::gltf::accessor::{Accessor, DataType, Dimensions, Item, Iter};
use ::gltf::buffer::View;

/// Rows `[count][N]` of an accessor with at least `N` components; integers are normalised where the accessor asks for it.
pub fn rows<const N: usize>(accessor: &Accessor<'_>, buffers: &[Vec<u8>]) -> Result<Vec<[f64; N]>, String> {
    check::<N>(accessor, buffers)?;
    match accessor.data_type() {
        DataType::I8 => typed::<i8, N>(accessor, buffers, f64::from(i8::MAX)),
        DataType::U8 => typed::<u8, N>(accessor, buffers, f64::from(u8::MAX)),
        DataType::I16 => typed::<i16, N>(accessor, buffers, f64::from(i16::MAX)),
        DataType::U16 => typed::<u16, N>(accessor, buffers, f64::from(u16::MAX)),
        DataType::U32 => typed::<u32, N>(accessor, buffers, f64::from(u32::MAX)),
        DataType::F32 => typed::<f32, N>(accessor, buffers, 1.0),
    }
    .ok_or_else(|| "an accessor goes beyond its buffer view".into())
}

/// The crate's iterator trusts counts, strides and offsets, and panics where they do not fit.
fn check<const N: usize>(accessor: &Accessor<'_>, buffers: &[Vec<u8>]) -> Result<(), String> {
    let width = accessor.dimensions().multiplicity();
    if width < N || width > 4 {
        return Err(format!("an accessor is of type {:?}, which cannot be used there", accessor.dimensions()));
    }
    let (size, count) = (accessor.size(), accessor.count());
    let mut parts = Vec::new();
    parts.extend(accessor.view().map(|view| (view, accessor.offset(), count, size)));
    if let Some(sparse) = accessor.sparse() {
        let (indices, values) = (sparse.indices(), sparse.values());
        if sparse.count() > count {
            return Err("a sparse accessor has more values than rows".into());
        }
        parts.push((indices.view(), indices.offset(), sparse.count(), indices.index_type().size()));
        parts.push((values.view(), values.offset(), sparse.count(), size));
    }
    if count == 0 || parts.iter().any(|(_, _, count, _)| *count == 0) {
        return Err("an accessor is empty".into());
    }
    let fits = |view: &View<'_>, offset: usize, count: usize, size: usize| {
        let stride = view.stride().unwrap_or(size);
        let end = stride.checked_mul(count - 1)?.checked_add(size)?.checked_add(offset)?;
        (stride >= size && end <= view_bytes(view, buffers)?.len()).then_some(())
    };
    if parts.iter().all(|(view, offset, count, size)| fits(view, *offset, *count, *size).is_some()) {
        Ok(())
    } else {
        Err("an accessor goes beyond its buffer view: the file is damaged".into())
    }
}

fn typed<T: Item + Copy + Into<f64>, const N: usize>(
    accessor: &Accessor<'_>,
    buffers: &[Vec<u8>],
    one: f64,
) -> Option<Vec<[f64; N]>> {
    let normalized = accessor.normalized() && one > 1.0;
    let number = |x: T| if normalized { (x.into() / one).max(-1.0) } else { x.into() };
    let row = |x: &[T]| std::array::from_fn(|k| number(x[k]));
    let data = |buffer: ::gltf::Buffer<'_>| buffers.get(buffer.index()).map(Vec::as_slice);
    let a = accessor.clone();
    Some(match accessor.dimensions() {
        Dimensions::Scalar => Iter::<T>::new(a, data)?.map(|x| row(&[x])).collect(),
        Dimensions::Vec2 => Iter::<[T; 2]>::new(a, data)?.map(|x| row(&x)).collect(),
        Dimensions::Vec3 => Iter::<[T; 3]>::new(a, data)?.map(|x| row(&x)).collect(),
        Dimensions::Vec4 => Iter::<[T; 4]>::new(a, data)?.map(|x| row(&x)).collect(),
        Dimensions::Mat2 | Dimensions::Mat3 | Dimensions::Mat4 => return None,
    })
}
