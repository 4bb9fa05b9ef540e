//! Values in lists by key, as compressed sparse rows.

/// Starts of the keys' lists, `[key + 1]`, and the values, by key and in the order in which they come. Keys are below `keys`.
#[must_use]
pub fn by_key<T: Copy>(keys: usize, pairs: impl Iterator<Item = (u32, T)> + Clone) -> (Vec<u32>, Vec<T>) {
    let mut starts = vec![0_u32; keys + 1];
    pairs.clone().for_each(|(key, _)| starts[key as usize + 1] += 1);
    for i in 0..keys {
        starts[i + 1] += starts[i];
    }
    let Some((_, any)) = pairs.clone().next() else { return (starts, Vec::new()) };
    let (mut next, mut values) = (starts.clone(), vec![any; starts[keys] as usize]);
    pairs.for_each(|(key, value)| {
        let at = &mut next[key as usize];
        values[*at as usize] = value;
        *at += 1;
    });
    (starts, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stand_by_key_in_their_order() {
        let pairs = [(2, 'a'), (0, 'b'), (2, 'c'), (3, 'd'), (2, 'e')];
        assert_eq!(by_key(5, pairs.into_iter()), (vec![0, 1, 1, 4, 5, 5], vec!['b', 'a', 'c', 'e', 'd']));
        assert_eq!(by_key::<u8>(2, [].into_iter()), (vec![0, 0, 0], vec![]));
    }
}
