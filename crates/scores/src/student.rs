//! Student's t distribution: its 97.5th percentile, and the probability of values further from 0.

/// The 97.5th percentile of the standard normal distribution.
const NORMAL: f64 = 1.959_963_984_540_054;

/// The probability that is left outside of an interval of 95 %.
const OUTSIDE: f64 = 0.05;

/// Returns the 97.5th percentile of Student's t distribution with `freedom` degrees of freedom, which need not be a whole
/// number but are at least 1.
pub(super) fn quantile(freedom: f64) -> f64 {
    let scale = density_scale(freedom);
    let mut t = NORMAL;
    // Newton's method. The tail is convex and the normal quantile lies below the root, so no step passes it.
    for _ in 0..100 {
        let tail = 2.0 * scale * (1.0 + t * t / freedom).powf(-0.5 * (freedom + 1.0));
        let step = (outside(t, freedom, scale) - OUTSIDE) / tail;
        t += step;
        if step <= t * f64::EPSILON {
            break;
        }
    }
    t
}

/// Returns the probability of a value further from 0 than `t`, on either side, with `freedom` degrees of freedom.
pub(super) fn two_sided(t: f64, freedom: f64) -> f64 {
    let (t, scale) = (t.abs(), density_scale(freedom));
    if t >= NORMAL {
        return outside(t, freedom, scale);
    }
    // The same function of the rest, where its fraction converges faster.
    let x = t * t / (freedom + t * t);
    1.0 - incomplete_beta(0.5, 0.5 * freedom, x, scale * freedom.sqrt())
}

/// The density at 0: `Gamma((v + 1) / 2) / (Gamma(v / 2) sqrt(pi v))`.
///
/// The quotient of gamma functions by its asymptotic expansion (F. G. Tricomi and A. Erdelyi, "The asymptotic expansion of a
/// ratio of gamma functions", Pacific J. Math. 1, 1951) where the next term is below 1e-15, and from there down by
/// `Gamma(x + 1) = x Gamma(x)`.
fn density_scale(freedom: f64) -> f64 {
    let (mut x, mut quotient) = (0.5 * freedom, 1.0);
    while x < 30.0 {
        quotient *= x / (x + 0.5);
        x += 1.0;
    }
    let inverse = 1.0 / x;
    let square = inverse * inverse;
    let series =
        -1.0 / 8.0 + square * (1.0 / 192.0 + square * (-1.0 / 640.0 + square * 17.0 / 14_336.0));
    quotient *= x.sqrt() * (inverse * series).exp();
    quotient / (std::f64::consts::PI * freedom).sqrt()
}

/// The probability of a value further from 0 than `t`: the regularized incomplete beta function at `v / (v + t^2)` with
/// parameters `v / 2` and 1/2. For `t` from the normal quantile on its fraction converges within some dozens of terms.
fn outside(t: f64, freedom: f64, density_scale: f64) -> f64 {
    // 1 / B(v / 2, 1/2) is the density's scale times the root of v.
    let x = freedom / (freedom + t * t);
    incomplete_beta(0.5 * freedom, 0.5, x, density_scale * freedom.sqrt())
}

/// The regularized incomplete beta function at `x` with parameters `a` and `b`, of which `scale` is `1 / B(a, b)`.
///
/// By its continued fraction (M. Abramowitz and I. A. Stegun, "Handbook of Mathematical Functions", 1964, 26.5.8), evaluated
/// with W. J. Lentz's method.
fn incomplete_beta(a: f64, b: f64, x: f64, scale: f64) -> f64 {
    let mut numerator = 1.0;
    let mut denominator = 1.0 / (1.0 - (a + b) * x / (a + 1.0));
    let mut fraction = denominator;
    for term in 1..500 {
        let m = f64::from(term);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut change = 1.0;
        for coefficient in [even, odd] {
            denominator = 1.0 / (1.0 + coefficient * denominator);
            numerator = 1.0 + coefficient / numerator;
            change = denominator * numerator;
            fraction *= change;
        }
        if (change - 1.0).abs() < f64::EPSILON {
            break;
        }
    }
    // x^a (1 - x)^b / (a B(a, b))
    x.powf(a) * (1.0 - x).powf(b) * scale / a * fraction
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of `scipy.stats.t.ppf(0.975, df)`.
    #[test]
    fn quantiles_are_those_of_scipy() {
        for (freedom, expected) in SCIPY {
            let found = quantile(freedom);
            assert!((found / expected - 1.0).abs() < 1e-12, "{freedom}: {found}, not {expected}");
        }
    }

    /// Values of `2 * scipy.stats.t.sf(t, df)`.
    #[test]
    fn probabilities_are_those_of_scipy() {
        for (t, freedom, expected) in TAILS {
            let found = two_sided(-t, freedom);
            assert!((found - expected).abs() < 1e-12, "{t}, {freedom}: {found}, not {expected}");
        }
        assert_eq!(two_sided(0.0, 4.0), 1.0);
    }

    const TAILS: [(f64, f64, f64); 12] = [
        (0.1, 1.0, 0.936548965138893),
        (1.0, 1.0, 0.5000000000000001),
        (1.9, 1.0, 0.30842822890066696),
        (12.7, 1.0, 0.050024327689344165),
        (0.5, 2.0, 0.6666666666666667),
        (1.5, 2.0, 0.2723931248910011),
        (1.95, 3.0, 0.1462737773972678),
        (1.96, 3.0, 0.14485220856485365),
        (0.7, 9.0, 0.501619039216145),
        (2.5, 9.0, 0.033861827682985735),
        (1.9, 250.0, 0.05858375448348646),
        (4.0, 250.0, 8.34702014587015e-05),
    ];

    const SCIPY: [(f64, f64); 14] = [
        (1.0, 12.706204736174694),
        (2.0, 4.302652729749462),
        (3.0, 3.1824463052837078),
        (4.72, 2.617132237456831),
        (7.0, 2.364624251592784),
        (11.5, 2.1893658938043634),
        (30.0, 2.0422724563012378),
        (51.0, 2.007583770315836),
        (59.5, 2.0006436102145173),
        (60.0, 2.0002978220142604),
        (101.0, 1.983731002955606),
        (301.0, 1.9678765312856952),
        (2500.0, 1.960913344795567),
        (100000.0, 1.9599877075346095),
    ];
}
