//! The 60 rotations of the icosahedron: no rotation is farther than 44.5 degrees from the nearest of them.

/// Rotations in the grid: the order of the icosahedron's group, which the tests check for closure.
pub(super) const COUNT: usize = 60;
/// Nearest neighbours of each, all 72 degrees away: a fifth of a turn about each of the twelve vertices, as the tests show.
const NEIGHBOURS: usize = 12;
/// Golden ratio, (1 + sqrt 5) / 2, from which the coordinates of the icosahedron are derived.
const PHI: f64 = 1.618_033_988_749_895;

/// Columns of each rotation matrix, one after the other.
pub(super) static COLUMNS: [[f64; 9]; COUNT] = columns();
/// `r_i r_j` for i <= j, row by row, of all rotations; a term that is not on the diagonal counts twice.
pub(super) static PRODUCTS: [[f64; COUNT]; 45] = products();
static NEAR: [[u8; NEIGHBOURS]; COUNT] = neighbours();

/// Indices of the rotations whose value is at most that of all their neighbours.
pub(super) fn minima(values: &[f64; COUNT]) -> impl Iterator<Item = usize> {
    (0..COUNT).filter(|&i| NEAR[i].iter().all(|&j| values[i] <= values[usize::from(j)]))
}

/// The binary icosahedral group up to sign: 12 quaternions of Hurwitz, and the even permutations of
/// (0, +-1, +-1/phi, +-phi) / 2.
const fn quaternions() -> [[f64; 4]; COUNT] {
    let mut q = [[0.0; 4]; COUNT];
    let mut n = 0;
    while n < 4 {
        q[n][n] = 1.0;
        n += 1;
    }
    let mut signs = 0;
    while signs < 8 {
        q[n] = [0.5, sign(signs, 0, 0.5), sign(signs, 1, 0.5), sign(signs, 2, 0.5)];
        (n, signs) = (n + 1, signs + 1);
    }
    // Places of 0, 1, 1/phi, phi: the even permutations of four.
    let places: [[usize; 4]; 12] = [
        [0, 1, 2, 3],
        [0, 2, 3, 1],
        [0, 3, 1, 2],
        [1, 0, 3, 2],
        [1, 2, 0, 3],
        [1, 3, 2, 0],
        [2, 0, 1, 3],
        [2, 1, 3, 0],
        [2, 3, 0, 1],
        [3, 0, 2, 1],
        [3, 1, 0, 2],
        [3, 2, 1, 0],
    ];
    let mut p = 0;
    while p < 12 {
        let mut signs = 0;
        while signs < 4 {
            q[n][places[p][1]] = 0.5;
            q[n][places[p][2]] = sign(signs, 0, 0.5 / PHI);
            q[n][places[p][3]] = sign(signs, 1, 0.5 * PHI);
            (n, signs) = (n + 1, signs + 1);
        }
        p += 1;
    }
    q
}

const fn sign(bits: usize, bit: usize, x: f64) -> f64 {
    if bits >> bit & 1 == 1 { -x } else { x }
}

const fn columns() -> [[f64; 9]; COUNT] {
    let q = quaternions();
    let mut all = [[0.0; 9]; COUNT];
    let mut n = 0;
    while n < COUNT {
        let [w, x, y, z] = q[n];
        all[n] = [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + w * z),
            2.0 * (x * z - w * y),
            2.0 * (x * y - w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + w * x),
            2.0 * (x * z + w * y),
            2.0 * (y * z - w * x),
            1.0 - 2.0 * (x * x + y * y),
        ];
        n += 1;
    }
    all
}

const fn products() -> [[f64; COUNT]; 45] {
    let r = columns();
    let mut all = [[0.0; COUNT]; 45];
    let mut n = 0;
    while n < COUNT {
        let (mut i, mut k) = (0, 0);
        while i < 9 {
            let mut j = i;
            while j < 9 {
                all[k][n] = r[n][i] * r[n][j] * if i == j { 1.0 } else { 2.0 };
                (j, k) = (j + 1, k + 1);
            }
            i += 1;
        }
        n += 1;
    }
    all
}

const fn neighbours() -> [[u8; NEIGHBOURS]; COUNT] {
    let q = quaternions();
    let mut all = [[0; NEIGHBOURS]; COUNT];
    let mut i = 0;
    while i < COUNT {
        let (mut j, mut n) = (0, 0);
        while j < COUNT {
            let dot = q[i][0] * q[j][0] + q[i][1] * q[j][1] + q[i][2] * q[j][2] + q[i][3] * q[j][3];
            // The 600-cell's neighbours lie at cos 36 degrees (its square is 0.654), the vertex itself at 1; all others must be below (0.25).
            if dot * dot > 0.6 && dot * dot < 0.7 {
                all[i][n] = j as u8;
                n += 1;
            }
            j += 1;
        }
        i += 1;
    }
    all
}

#[cfg(test)]
mod tests {
    #![allow(clippy::needless_range_loop)] // indices of the group's elements

    use super::*;
    use nalgebra::{Matrix3, Rotation3, Vector3};
    use proptest::prelude::*;

    fn rotation(i: usize) -> Rotation3<f64> {
        Rotation3::from_matrix_unchecked(Matrix3::from_column_slice(&COLUMNS[i]))
    }

    #[test]
    fn a_group_of_sixty_rotations() {
        for i in 0..COUNT {
            let R = rotation(i);
            assert!(
                (R.matrix().determinant() - 1.0).abs() < 1e-14
                    && (R.matrix() * R.matrix().transpose() - Matrix3::identity()).norm() < 1e-14
            );
            for j in 0..COUNT {
                let product = R * rotation(j);
                assert!((0..COUNT).any(|k| (rotation(k).matrix() - product.matrix()).norm() < 1e-13));
                assert_eq!(i == j, R.angle_to(&rotation(j)) < 1.2);
            }
            assert!(
                NEAR[i]
                    .iter()
                    .all(|&j| (R.angle_to(&rotation(usize::from(j))).to_degrees() - 72.0).abs() < 1e-9)
            );
        }
    }

    proptest! {
        #[test]
        fn every_rotation_has_one_near(w in prop::array::uniform3(-3.0..3.0f64), a in prop::collection::vec(-1.0..1.0f64, 45)) {
            let R = Rotation3::from_scaled_axis(Vector3::from(w));
            prop_assert!((0..COUNT).any(|i| R.angle_to(&rotation(i)).to_degrees() < 44.6));
            let i = (a[0].abs() * 59.0) as usize;
            let form: f64 = (0..45).map(|k| a[k] * PRODUCTS[k][i]).sum();
            let (mut k, mut slow) = (0, 0.0);
            for x in 0..9 {
                for y in x..9 {
                    slow += a[k] * COLUMNS[i][x] * COLUMNS[i][y] * if x == y { 1.0 } else { 2.0 };
                    k += 1;
                }
            }
            prop_assert!((form - slow).abs() < 1e-12);
        }
    }
}
