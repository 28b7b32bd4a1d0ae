//! Classifiers that search for decoys among the rows of sealed queries, and their accuracy.

use std::ops::Range;

use rand::Rng as _;
use rand::seq::index::sample;
use veiloc_descriptor::{DescriptorKind, Encoding};
use veiloc_geometry::nalgebra::{DMatrix, SymmetricEigen};

use crate::decoys::common::rng;

/// Rows of a query that was filled up with decoys.
const ROWS: usize = 256;

/// One row of a sealed query as the attacker sees it, with the ground truth.
pub(crate) struct Row {
    pub(crate) image: usize,
    pub(crate) descriptor: Vec<f64>,
    /// Index of the anchor, and the angle at it, radians.
    pub(crate) line: (usize, f64),
    pub(crate) decoy: bool,
}

/// Another row: similarity of the descriptors, same anchor, near angle, equal angle.
type NearRow = (f64, bool, bool, bool);

/// Rows whose angles at one anchor differ by less are near each other, radians.
const NEAR: f64 = 0.12;

/// Descriptors and angles together: how often a decoy is ranked above a real row by a logistic regression of eleven
/// numbers and their products, trained on other images. A row that belongs to the image has its likest rows near it, in
/// the angles too.
pub(crate) fn joint(rows: &[Row]) -> f64 {
    let mut inputs = Vec::with_capacity(rows.len());
    for query in rows.chunks(ROWS) {
        let mean = mean_of(&query.iter().map(|row| &row.descriptor[..]).collect::<Vec<_>>());
        let unit: Vec<Vec<f64>> = (query.iter())
            .map(|row| {
                let centred = less(&row.descriptor, &mean);
                let length = dot(&centred, &centred).sqrt().max(1e-9);
                centred.iter().map(|value| value / length).collect()
            })
            .collect();
        for (i, row) in query.iter().enumerate() {
            let mut others: Vec<NearRow> = (0..query.len())
                .filter(|j| *j != i)
                .map(|j| {
                    let same = query[j].line.0 == row.line.0;
                    let apart = (query[j].line.1 - row.line.1).abs();
                    (dot(&unit[i], &unit[j]), same, same && apart < NEAR, same && apart == 0.0)
                })
                .collect();
            others.sort_by(|a, b| b.0.total_cmp(&a.0));
            let share = |of: &dyn Fn(&NearRow) -> bool, first: usize| {
                others.iter().take(first).filter(|other| of(other)).count() as f64 / first as f64
            };
            let best = |of: &dyn Fn(&NearRow) -> bool| {
                others.iter().find(|other| of(other)).map_or(-1.0, |other| other.0)
            };
            let crowd = share(&|other| other.2, others.len());
            let near = best(&|other| other.2);
            inputs.push(vec![
                others[0].0,
                share(&|other| other.1, 5),
                share(&|other| other.1, 1),
                share(&|other| other.2, 1) - crowd,
                share(&|other| other.2, 5) - crowd,
                near,
                best(&|other| !other.1) - best(&|other| other.1),
                near - others[0].0,
                share(&|other| other.3, others.len()),
                best(&|other| other.3),
                crowd,
            ]);
        }
    }
    standardize(&mut inputs);
    let mut of_rows = inputs.into_iter().map(with_products);
    auc(&trained(rows, |_| of_rows.next().expect("one for each row")).concat())
}

/// Scales each column to mean 0 and variance 1.
fn standardize(inputs: &mut [Vec<f64>]) {
    let count = inputs.len() as f64;
    for column in 0..inputs[0].len() {
        let mean = inputs.iter().map(|x| x[column]).sum::<f64>() / count;
        let sd = (inputs.iter().map(|x| (x[column] - mean).powi(2)).sum::<f64>() / count).sqrt().max(1e-9);
        for x in &mut *inputs {
            x[column] = (x[column] - mean) / sd;
        }
    }
}

/// Numbers of about unit variance with all their products, scaled for the regression.
fn with_products(x: Vec<f64>) -> Vec<f64> {
    let products = (0..x.len()).flat_map(|i| (i..x.len()).map(move |j| (i, j)));
    let products: Vec<f64> = products.map(|(i, j)| (x[i] * x[j]).clamp(-4.0, 4.0)).collect();
    x.into_iter().chain(products).map(|value| 0.2 * value).collect()
}

/// Principal components whose energy is one number.
const GROUP: usize = 8;

/// What the energies of principal components tell. The components are those of all rows of a query.
pub(crate) struct EnergyAttack {
    /// How often a decoy is ranked above a real row of the same image, by a logistic regression of the energies of groups
    /// of components and their products, trained on other images.
    pub(crate) within_image: f64,
    /// The same of all rows of all images together.
    pub(crate) over_images: f64,
    /// Correlation of the number of real rows with what a regression of the moments of these energies says, trained on
    /// other images.
    pub(crate) count: f64,
}

/// The attack by energies of principal components, relative to their mean in the query.
pub(crate) fn energies(rows: &[Row]) -> EnergyAttack {
    let (mut inputs, mut moments, mut counts) = (Vec::new(), Vec::new(), Vec::new());
    for query in rows.chunks(ROWS) {
        let mean = mean_of(&query.iter().map(|row| &row.descriptor[..]).collect::<Vec<_>>());
        let centred = DMatrix::from_fn(query.len(), mean.len(), |i, j| query[i].descriptor[j] - mean[j]);
        let eigen = SymmetricEigen::new(centred.transpose() * &centred);
        let mut order: Vec<usize> = (0..mean.len()).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let parts = &centred * &eigen.eigenvectors;
        let energy = |row: usize, group: &[usize]| {
            (group.iter().map(|i| parts[(row, *i)].powi(2)).sum::<f64>() + 1.0).ln()
        };
        let mut own: Vec<Vec<f64>> = (0..query.len())
            .map(|row| order.chunks(GROUP).map(|group| energy(row, group)).collect())
            .collect();
        let groups = own[0].len();
        let column = |i: usize| own.iter().map(move |x| x[i]);
        let of_image: Vec<f64> = (0..groups)
            .flat_map(|i| {
                let n = query.len() as f64;
                let mean = column(i).sum::<f64>() / n;
                let moment = |power: i32| column(i).map(|x| (x - mean).powi(power)).sum::<f64>() / n;
                let sd = moment(2).sqrt().max(1e-9);
                [mean, sd, moment(3) / sd.powi(3)]
            })
            .collect();
        moments.push(of_image);
        counts.push(query.iter().filter(|row| !row.decoy).count() as f64);
        standardize(&mut own);
        inputs.extend(own);
    }
    let mut of_rows = inputs.into_iter().map(with_products);
    let judged = trained(rows, |_| of_rows.next().expect("one for each row"));
    let within_image = judged.iter().map(|image| auc(image)).sum::<f64>() / judged.len() as f64;
    standardize(&mut moments);
    EnergyAttack {
        within_image,
        over_images: auc(&judged.concat()),
        count: estimated_from(&moments, &counts),
    }
}

/// Correlation of numbers of odd images with a ridge regression on even ones.
fn estimated_from(moments: &[Vec<f64>], numbers: &[f64]) -> f64 {
    let columns = moments[0].len() + 1;
    let input = |image: usize, column: usize| if column == 0 { 1.0 } else { moments[image][column - 1] };
    let of_half = |odd: usize| -> (DMatrix<f64>, DMatrix<f64>) {
        let images: Vec<usize> = (odd..moments.len()).step_by(2).collect();
        let x = DMatrix::from_fn(images.len(), columns, |i, j| input(images[i], j));
        (x, DMatrix::from_fn(images.len(), 1, |i, _| numbers[images[i]]))
    };
    let ((train, known), (test, truth)) = (of_half(0), of_half(1));
    let ridge = DMatrix::<f64>::identity(columns, columns) * 3.0;
    let normal: DMatrix<f64> = train.transpose() * &train + ridge;
    let weights = normal.lu().solve(&(train.transpose() * known)).expect("positive definite");
    let found = test * weights;
    let centred = |v: &DMatrix<f64>| v.add_scalar(-v.mean());
    let (a, b) = (centred(&found), centred(&truth));
    a.dot(&b) / (a.norm() * b.norm()).max(1e-9)
}

/// Name of a measure, its AUC, and the allowed range of the AUC.
pub(crate) type MeasureAuc = (&'static str, f64, Range<f64>);

/// Probability that a decoy has a higher value than a real row: 0.5 is chance.
fn auc(values: &[(f64, bool)]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut below, mut wins, mut at) = (0.0, 0.0, 0);
    while at < sorted.len() {
        let end = at + sorted[at..].iter().take_while(|v| v.0 == sorted[at].0).count();
        let decoys = sorted[at..end].iter().filter(|v| v.1).count() as f64;
        let real = (end - at) as f64 - decoys;
        wins += decoys * (below + real / 2.0);
        below += real;
        at = end;
    }
    wins / (below * (sorted.len() as f64 - below))
}

/// AUC of a scalar of each row.
pub(crate) fn simple(rows: &[Row], value: impl Fn(&Row) -> f64) -> f64 {
    auc(&rows.iter().map(|row| (value(row), row.decoy)).collect::<Vec<_>>())
}

/// Logistic regression on features of a row, trained on even images: the scores of the rows of each odd one.
fn trained(rows: &[Row], mut features: impl FnMut(&Row) -> Vec<f64>) -> Vec<Vec<(f64, bool)>> {
    let inputs: Vec<(Vec<f64>, bool, bool)> =
        rows.iter().map(|r| (features(r), r.decoy, r.image % 2 == 0)).collect();
    let mut weights = vec![0.0; inputs[0].0.len() + 1];
    let score = |w: &[f64], x: &[f64]| w[0] + x.iter().zip(&w[1..]).map(|(a, b)| a * b).sum::<f64>();
    for epoch in 0..60 {
        let rate = 0.05 / (1.0 + f64::from(epoch) / 10.0);
        for (x, decoy, train) in &inputs {
            if *train {
                let error = f64::from(u8::from(*decoy)) - 1.0 / (1.0 + (-score(&weights, x)).exp());
                weights[0] += rate * error;
                weights[1..].iter_mut().zip(x).for_each(|(w, v)| *w += rate * error * v);
            }
        }
    }
    let images = inputs.chunks(ROWS).filter(|image| !image[0].2);
    images.map(|image| image.iter().map(|(x, decoy, _)| (score(&weights, x), *decoy)).collect()).collect()
}

/// The other rows of a row's query.
fn others<'a>(rows: &'a [Row], row: &Row) -> Vec<&'a Row> {
    rows.iter()
        .skip(row.image * ROWS)
        .take(ROWS)
        .filter(|other| !std::ptr::eq(*other, row))
        .inspect(|other| assert_eq!(other.image, row.image))
        .collect()
}

fn length(row: &Row) -> f64 {
    dot(&row.descriptor, &row.descriptor).sqrt()
}

fn sum(row: &Row) -> f64 {
    row.descriptor.iter().sum()
}

/// Negative distance to the nearest other row of the query: the nearer, the higher.
fn nearness(rows: &[Row], row: &Row) -> f64 {
    let distance =
        |o: &&Row| row.descriptor.iter().zip(&o.descriptor).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    -others(rows, row).iter().map(distance).fold(f64::INFINITY, f64::min)
}

/// The share of a centred row that three other rows explain, selected greedily by the most explained: an attack that
/// knows that decoys are sums of rows.
fn explained(row: &[f64], others: &[&[f64]], mean: &[f64]) -> f64 {
    let mut left = less(row, mean);
    let mut others: Vec<Vec<f64>> = others.iter().map(|other| less(other, mean)).collect();
    let whole = dot(&left, &left);
    for _ in 0..3 {
        let part = |other: &Vec<f64>| dot(&left, other).powi(2) / dot(other, other).max(1e-6);
        let best = others.iter().max_by(|a, b| part(a).total_cmp(&part(b))).expect("a row").clone();
        remove_component(&mut left, &best);
        for other in &mut others {
            remove_component(other, &best);
        }
    }
    1.0 - dot(&left, &left) / whole.max(1e-6)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Removes the component of a row along a direction.
fn remove_component(row: &mut [f64], direction: &[f64]) {
    let part = dot(row, direction) / dot(direction, direction).max(1e-6);
    row.iter_mut().zip(direction).for_each(|(value, along)| *value -= part * along);
}

/// The mean of some rows.
fn mean_of(rows: &[&[f64]]) -> Vec<f64> {
    (0..rows[0].len()).map(|i| rows.iter().map(|row| row[i]).sum::<f64>() / rows.len() as f64).collect()
}

fn less(row: &[f64], mean: &[f64]) -> Vec<f64> {
    row.iter().zip(mean).map(|(value, mean)| value - mean).collect()
}

/// The share of images whose number of real rows is estimated to within two; printed.
#[expect(clippy::print_stderr, reason = "the figures of the document")]
pub(crate) fn share_counted(kind: &str, rows: &[Row], count: usize) -> f64 {
    let seems: Vec<usize> = rows.chunks(ROWS).map(estimated_real_rows).collect();
    let share = seems.iter().filter(|n| n.abs_diff(count) <= 2).count() as f64 / seems.len() as f64;
    eprintln!("{share:.2}  {kind}: images whose number of real rows, {count}, is estimated");
    share
}

/// Estimated number of real rows: rows are removed one after the other, always the one with the largest remainder; a
/// sudden drop of the remainder marks the end of the real rows.
fn estimated_real_rows(rows: &[Row]) -> usize {
    let all: Vec<&[f64]> = rows.iter().map(|row| &row.descriptor[..]).collect();
    let mean = mean_of(&all);
    let mut left: Vec<Vec<f64>> = all.iter().map(|row| less(row, &mean)).collect();
    let most_left: Vec<f64> = (0..mean.len() - 2)
        .map(|_| {
            let most = left.iter().max_by(|a, b| dot(a, a).total_cmp(&dot(b, b))).expect("a row").clone();
            for row in &mut left {
                remove_component(row, &most);
            }
            dot(&most, &most)
        })
        .collect();
    let drop = |i: &usize| most_left[i - 1] / most_left[*i].max(1e-6);
    (5..most_left.len()).max_by(|a, b| drop(a).total_cmp(&drop(b))).expect("a step")
}

/// The measures that are applied to all kinds.
pub(crate) fn of_blends(kind: DescriptorKind, rows: &[Row]) -> [(&'static str, f64); 9] {
    // Scaled to about unit variance.
    let unit = f64::from(kind.norm()) / (kind.dim() as f64).sqrt();
    let middle = if kind.encoding() == Encoding::Unsigned { 0.8 } else { 0.0 };
    let numbers = |r: &Row| r.descriptor.iter().map(|v| v / unit - middle).collect::<Vec<f64>>();
    let products = |r: &Row| {
        let x = numbers(r);
        let pairs = (0..x.len()).flat_map(|i| (i..x.len()).map(move |j| (i, j)));
        pairs.map(|(i, j)| x[i] * x[j] * 8.0 / x.len() as f64).collect()
    };
    let mut draw = rng(4);
    let layer: Vec<(Vec<f64>, f64)> = (0..500)
        .map(|_| {
            let spread = 3.0 / (kind.dim() as f64).sqrt();
            let weights = (0..kind.dim()).map(|_| spread * draw.random_range(-1.0..1.0));
            (weights.collect(), draw.random_range(-1.0..1.0))
        })
        .collect();
    let hinges = |r: &Row| {
        let x = numbers(r);
        layer.iter().map(|(weights, offset)| (dot(weights, &x) + offset).max(0.0) * 0.2).collect()
    };
    let largest = |r: &Row| r.descriptor.iter().map(|v| v.abs()).fold(0.0, f64::max);
    [
        ("length of the vector", simple(rows, length)),
        ("sum", simple(rows, sum)),
        ("largest number", simple(rows, largest)),
        ("distance to the nearest row", simple(rows, |r| nearness(rows, r))),
        ("logistic regression trained on decoys", auc(&trained(rows, numbers).concat())),
        ("the same of products of two numbers", auc(&trained(rows, products).concat())),
        ("the same of 500 random hinges", auc(&trained(rows, hinges).concat())),
        ("search for the rows it is a sum of", simple(rows, |r| found_in(&others(rows, r), r))),
        ("the same, of sums of three rows", sums_of_three(rows)),
    ]
}

fn found_in(others: &[&Row], row: &Row) -> f64 {
    let others: Vec<&[f64]> = others.iter().map(|other| &other.descriptor[..]).collect();
    explained(&row.descriptor, &others, &mean_of(&others))
}

/// AUC of the search for the three rows of a sum, on true sums of three rows: shows that the search can succeed.
fn sums_of_three(rows: &[Row]) -> f64 {
    let mut draw = rng(3);
    let of_image = |image: usize| {
        let real: Vec<&Row> = rows.iter().filter(|r| r.image == image && !r.decoy).collect();
        let parents: Vec<(usize, f64)> =
            sample(&mut draw, real.len(), 3).into_iter().map(|i| (i, draw.random_range(0.3..0.7))).collect();
        let number = |i: usize| parents.iter().map(|(row, part)| part * real[*row].descriptor[i]).sum();
        let descriptor = (0..real[0].descriptor.len()).map(number).collect();
        let row = Row { image, descriptor, line: (0, 0.0), decoy: true };
        let own = real.iter().enumerate().map(|(i, r)| {
            let rest: Vec<&Row> = real.iter().enumerate().filter(|(j, _)| i != *j).map(|(_, r)| *r).collect();
            (found_in(&rest, r), false)
        });
        own.chain([(found_in(&real, &row), true)]).collect::<Vec<_>>()
    };
    auc(&(0..rows.len() / ROWS).flat_map(of_image).collect::<Vec<_>>())
}

/// Prints the results and checks them against the ranges that the documentation reports.
#[expect(clippy::print_stderr, reason = "the figures of the document")]
pub(crate) fn check_measures(kind: &str, rows: &[Row], found: &[MeasureAuc]) {
    eprintln!("AUC of telling decoys from real rows of {kind}, 0.5 is chance, {} images:", rows.len() / ROWS);
    for (what, found, _) in found {
        eprintln!("{found:.2}  {what}");
    }
    for (what, found, allowed) in found {
        assert!(allowed.contains(found), "{kind}, {what}: {found:.3}");
    }
}
