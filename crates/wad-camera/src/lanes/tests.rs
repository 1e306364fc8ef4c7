use super::*;

/// What a lane makes of eight pairs of numbers.
#[inline(always)]
fn work<L: Lane>(x: &[f32; 8], y: &[f32; 8], table: &[u32]) -> Vec<u32> {
    let mut out = Vec::new();
    for at in (0..8).step_by(L::COUNT) {
        let (a, b) = (L::load(&x[at..]), L::load(&y[at..]));
        let results = [
            a.min(b),
            a.max(b).fma(a, b),
            a.abs().root(),
            a.floor(),
            a.abs() / b,
            L::select(L::less(a, b), a, b),
            L::texel(table, 2, a, b),
            L::random(a.floor(), b.floor(), 99),
            a.mix(b, b.unit()),
        ];
        for (n, result) in results.into_iter().enumerate() {
            let mut row = [0.0; 8];
            result.store(&mut row);
            out.extend(row[..L::COUNT].iter().enumerate().map(|(i, v)| (n * 8 + at + i, v.to_bits())));
        }
        let mut packed = [7; 8];
        L::pack(a.unit(), b.unit(), a.unit(), &mut packed, L::less(a, L::splat(0.3)));
        out.extend(packed[..L::COUNT].iter().enumerate().map(|(i, &v)| (72 + at + i, v)));
    }
    out.sort_unstable();
    out.into_iter().map(|(_, bits)| bits).collect()
}

#[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx2,fma,bmi1,bmi2")]
fn most(x: &[f32; 8], y: &[f32; 8], table: &[u32]) -> Vec<u32> {
    work::<Eight>(x, y, table)
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
fn eight(x: &[f32; 8], y: &[f32; 8], table: &[u32]) -> Vec<u32> {
    work::<Eight>(x, y, table)
}

#[test]
fn eight_lanes_have_the_bits_of_single_numbers() {
    use crate::simd::{Instructions, instructions};
    if instructions() < Instructions::Avx2 {
        return;
    }
    let table: Vec<u32> = (0..16_u32).map(crate::simd::hash).collect();
    for round in 0..200_u32 {
        let numbers = |seed: u32| std::array::from_fn(|i| (crate::simd::unit(seed + i as u32) - 0.3) * 40.0);
        let (x, y) = (numbers(round * 16), numbers(round * 16 + 8));
        // SAFETY: asked for above.
        assert_eq!(unsafe { eight(&x, &y, &table) }, work::<f32>(&x, &y, &table));
        if instructions() == Instructions::Avx512 {
            // SAFETY: asked for above.
            assert_eq!(unsafe { most(&x, &y, &table) }, work::<f32>(&x, &y, &table));
        }
    }
}
