//! Linear probes: regressions on the latent, measured on unseen frames.

use nalgebra::{DMatrix, DVector};

/// A logistic regression.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// One per feature, then the bias.
    weights: DVector<f64>,
}

/// Newton steps.
const STEPS: usize = 12;
/// Candidate L2 penalties: with few positives, 200 weights need a strong one.
const PENALTIES: [f64; 4] = [1.0, 10.0, 100.0, 1000.0];
/// Last share of the fitted frames, held back to choose the penalty.
const HELD_BACK: f64 = 0.3;

impl Probe {
    /// Fits by Newton's method with the L2 penalty that ranks the last part best when fitted to the
    /// first. None if all labels are equal or there are none.
    pub fn fit(features: &[Vec<f32>], labels: &[bool]) -> Option<Self> {
        if features.len() != labels.len() {
            return None;
        }
        let first = features.len() - (HELD_BACK * features.len() as f64) as usize;
        let rank = |penalty: f64| {
            let probe = Self::fit_with(&features[..first], &labels[..first], penalty)?;
            let scores: Vec<f64> = features[first..].iter().map(|row| probe.score(row)).collect();
            auc(&scores, &labels[first..])
        };
        let ranked = PENALTIES.iter().filter_map(|&penalty| Some((rank(penalty)?, penalty)));
        let best = ranked.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(PENALTIES[0], |(_, penalty)| penalty);
        Self::fit_with(features, labels, best)
    }

    fn fit_with(features: &[Vec<f32>], labels: &[bool], penalty: f64) -> Option<Self> {
        let size = features.first()?.len() + 1;
        let positives = labels.iter().filter(|label| **label).count();
        if positives == 0 || positives == labels.len() || labels.len() != features.len() {
            return None;
        }
        let rows = features.len();
        let x = DMatrix::from_fn(rows, size, |i, j| features[i].get(j).map_or(1.0, |v| f64::from(*v)));
        let y = DVector::from_fn(rows, |i, _| f64::from(u8::from(labels[i])));
        let mut weights = DVector::zeros(size);
        for _ in 0..STEPS {
            let p = (&x * &weights).map(|z: f64| 1.0 / (1.0 + (-z).exp()));
            let mut gradient = x.tr_mul(&(&p - &y)) + &weights * penalty;
            gradient[size - 1] -= weights[size - 1] * penalty;
            let mut scaled = x.clone();
            for (i, mut row) in scaled.row_iter_mut().enumerate() {
                row *= (p[i] * (1.0 - p[i])).max(1e-6);
            }
            let mut hessian = x.tr_mul(&scaled);
            for i in 0..size {
                hessian[(i, i)] += if i + 1 == size { 1e-6 } else { penalty };
            }
            let step = hessian.cholesky()?.solve(&gradient);
            weights -= &step;
            if step.norm() < 1e-6 * (1.0 + weights.norm()) {
                break;
            }
        }
        Some(Self { weights })
    }

    /// The log-odds of a positive.
    pub fn score(&self, features: &[f32]) -> f64 {
        linear(&self.weights, features)
    }
}

/// A linear regression.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// One per feature, then the bias.
    weights: DVector<f64>,
}

impl Regression {
    /// Least squares with the L2 penalty that explains the last part best when fitted to the first.
    /// None without values.
    pub fn fit(features: &[Vec<f32>], values: &[f64]) -> Option<Self> {
        if values.len() != features.len() {
            return None;
        }
        let first = features.len() - (HELD_BACK * features.len() as f64) as usize;
        let part = Normal::of(&features[..first], &values[..first])?;
        let rank = |penalty: f64| {
            let line = part.solve(penalty)?;
            let made: Vec<f64> = features[first..].iter().map(|row| line.value(row)).collect();
            explained(&made, &values[first..])
        };
        let ranked = PENALTIES.iter().filter_map(|&penalty| Some((rank(penalty)?, penalty)));
        let best = ranked.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(PENALTIES[0], |(_, penalty)| penalty);
        Normal::of(features, values)?.solve(best)
    }

    /// The predicted value.
    pub fn value(&self, features: &[f32]) -> f64 {
        linear(&self.weights, features)
    }
}

/// The normal equations of a least squares problem, before the penalty.
struct Normal {
    matrix: DMatrix<f64>,
    rhs: DVector<f64>,
}

impl Normal {
    fn of(features: &[Vec<f32>], values: &[f64]) -> Option<Self> {
        let size = features.first()?.len() + 1;
        let x =
            DMatrix::from_fn(features.len(), size, |i, j| features[i].get(j).map_or(1.0, |v| f64::from(*v)));
        Some(Self { matrix: x.tr_mul(&x), rhs: x.tr_mul(&DVector::from_column_slice(values)) })
    }

    fn solve(&self, penalty: f64) -> Option<Regression> {
        let mut matrix = self.matrix.clone();
        let last = matrix.nrows() - 1;
        for i in 0..=last {
            matrix[(i, i)] += if i == last { 1e-6 } else { penalty };
        }
        Some(Regression { weights: matrix.cholesky()?.solve(&self.rhs) })
    }
}

fn linear(weights: &DVector<f64>, features: &[f32]) -> f64 {
    let bias = weights[weights.len() - 1];
    bias + features.iter().zip(weights.iter()).map(|(x, w)| f64::from(*x) * w).sum::<f64>()
}

/// Share of the variance of `wanted` that `made` explains; None if there is no variance.
pub fn explained(made: &[f64], wanted: &[f64]) -> Option<f64> {
    let mean = wanted.iter().sum::<f64>() / wanted.len().max(1) as f64;
    let all: f64 = wanted.iter().map(|y| (y - mean).powi(2)).sum();
    let left: f64 = made.iter().zip(wanted).map(|(x, y)| (x - y).powi(2)).sum();
    (all > 0.0).then(|| 1.0 - left / all)
}

/// Area under the ROC curve: how often a positive scores above a negative, ties counted half. None where
/// one kind is missing.
pub fn auc(scores: &[f64], labels: &[bool]) -> Option<f64> {
    let mut order: Vec<usize> = (0..scores.len().min(labels.len())).collect();
    order.sort_by(|&a, &b| scores[a].total_cmp(&scores[b]));
    let (mut below, mut wins, mut positives) = (0.0, 0.0, 0.0);
    let mut at = 0;
    while at < order.len() {
        let tied = order[at..].iter().take_while(|&&i| scores[i] == scores[order[at]]).count();
        let group = &order[at..at + tied];
        let plus = group.iter().filter(|&&i| labels[i]).count() as f64;
        let minus = tied as f64 - plus;
        wins += plus * (below + 0.5 * minus);
        below += minus;
        positives += plus;
        at += tied;
    }
    (positives > 0.0 && below > 0.0).then(|| wins / (positives * below))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use sumo_network::seeds;

    #[test]
    fn auc_counts_pairs() {
        let labels = [false, false, true, true];
        assert_eq!(auc(&[0.1, 0.4, 0.35, 0.8], &labels), Some(0.75));
        assert_eq!(auc(&[0.5; 4], &labels), Some(0.5));
        assert_eq!(auc(&[0.5; 4], &[true; 4]), None);
    }

    #[test]
    fn a_regression_explains_what_is_linear_and_not_noise() {
        let mut rng = seeds::rng(2, "regression");
        let rows: Vec<Vec<f32>> =
            (0..3000).map(|_| (0..20).map(|_| rng.random::<f32>() - 0.5).collect()).collect();
        let told: Vec<f64> = rows.iter().map(|r| 3.0 + f64::from(r[4] - 2.0 * r[9])).collect();
        let noise: Vec<f64> = rows.iter().map(|_| rng.random::<f64>()).collect();
        let (fit, rest) = rows.split_at(2000);
        let share = |values: &[f64]| {
            let line = Regression::fit(fit, &values[..2000]).unwrap();
            let made: Vec<f64> = rest.iter().map(|row| line.value(row)).collect();
            explained(&made, &values[2000..]).unwrap()
        };
        assert!(share(&told) > 0.99 && share(&noise) < 0.05, "{} {}", share(&told), share(&noise));
        assert_eq!(Regression::fit(&[], &[]), None);
    }

    #[test]
    fn a_probe_finds_the_direction_and_not_more() {
        let mut rng = seeds::rng(1, "probe");
        let mut draw = |count: usize| -> (Vec<Vec<f32>>, Vec<bool>, Vec<bool>) {
            let rows: Vec<Vec<f32>> =
                (0..count).map(|_| (0..20).map(|_| rng.random::<f32>() - 0.5).collect()).collect();
            let told = rows.iter().map(|r| r[3] - 2.0 * r[7] > 0.1).collect();
            let chance = rows.iter().map(|_| rng.random::<bool>()).collect();
            (rows, told, chance)
        };
        let (train, told, chance) = draw(2000);
        let (test, told_test, chance_test) = draw(2000);
        let rank = |labels: &[bool], test_labels: &[bool]| {
            let probe = Probe::fit(&train, labels).unwrap();
            let scores: Vec<f64> = test.iter().map(|row| probe.score(row)).collect();
            auc(&scores, test_labels).unwrap()
        };
        assert!(rank(&told, &told_test) > 0.99);
        assert!((rank(&chance, &chance_test) - 0.5).abs() < 0.05);
        assert_eq!(Probe::fit(&train, &vec![true; 2000]), None);
    }
}
