//! LayerNorm at small variances, softplus, and log-softmax against values and gradients computed in `f64`.

use crate::common::{TOLERANCE, floats, generate, golden_path, numbers, read_json, relative_error, values};
use burn::module::Param;
use burn::nn::LayerNormConfig;
use burn::tensor::{Device, Tensor, TensorData, activation};

#[test]
fn generator_gives_the_example() {
    let golden = &read_json(&golden_path("units.json"))["splitmix_example"];
    let name = golden["name"].as_str().unwrap();
    assert_eq!(generate(name, golden["seed"].as_u64().unwrap(), 8), numbers(&golden["first8"]));
}

#[test]
fn layer_norm_matches_at_every_variance() {
    let golden = read_json(&golden_path("units.json"));
    let device = Device::flex().autodiff();
    for case in golden["layernorm"].as_array().unwrap() {
        let rows = case["x"].as_array().unwrap().len();
        let width = case["scale"].as_array().unwrap().len();
        let matrix = |key: &str| Tensor::<2>::from_data(TensorData::new(floats(&case[key]), [rows, width]), &device);
        let vector = |key: &str| Tensor::<1>::from_data(TensorData::new(floats(&case[key]), [width]), &device);
        let mut layer = LayerNormConfig::new(width).init(&device);
        layer.gamma = Param::from_tensor(vector("scale"));
        layer.beta = Some(Param::from_tensor(vector("offset")));
        let x = matrix("x").require_grad();
        let y = layer.forward(x.clone());
        let gradients = (y.clone() * matrix("dy")).sum().backward();
        // Centering x ≈ 0.7 in f32 loses 0.7 · 2⁻²⁴ / sd of each normalized entry, which is below the common tolerance
        // only for larger standard deviations. Equal rows (sd 0) may keep one rounding error of the mean, divided by
        // √ε.
        let sd = case["sd"].as_f64().unwrap();
        let tolerance = TOLERANCE.max(1e-7 / sd.max(1e-5_f64.sqrt()));
        for (name, ours, expected) in [
            ("y", values(y), &case["y"]),
            ("dx", values(x.grad(&gradients).unwrap()), &case["dx"]),
            ("doffset", values(layer.beta.as_ref().unwrap().val().grad(&gradients).unwrap()), &case["doffset"]),
        ] {
            let error = relative_error(&ours, &numbers(expected));
            assert!(error <= tolerance, "{name} at sd {sd} is off by {error:e}");
        }
        let dscale = values(layer.gamma.val().grad(&gradients).unwrap());
        let largest = numbers(&case["dy"]).iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (ours, expected) in dscale.iter().zip(numbers(&case["dscale"])) {
            let error = (f64::from(*ours) - expected).abs();
            assert!(error <= tolerance * largest * rows as f64, "dscale at sd {sd} is off by {error:e}");
        }
    }
}

#[test]
fn softplus_matches_from_end_to_end() {
    let golden = &read_json(&golden_path("units.json"))["softplus_plus_1e-6"];
    let xs = floats(&golden["x"]);
    let x = Tensor::<1>::from_data(TensorData::new(xs.clone(), [xs.len()]), &Device::flex().autodiff()).require_grad();
    let y = activation::softplus(x.clone(), 1.0).add_scalar(1e-6);
    let slope = values(x.grad(&y.clone().sum().backward()).unwrap());
    let y = values(y);
    for (k, (expected, slope_expected)) in numbers(&golden["y"]).iter().zip(numbers(&golden["dydx"])).enumerate() {
        assert!((f64::from(y[k]) - expected).abs() <= 1e-6 * expected, "softplus({}) is {}", xs[k], y[k]);
        assert!((f64::from(slope[k]) - slope_expected).abs() <= 1e-6, "slope at {} is {}", xs[k], slope[k]);
    }
}

#[test]
fn log_softmax_matches() {
    let golden = &read_json(&golden_path("units.json"))["log_softmax"];
    let xs = floats(&golden["x"]);
    let rows = golden["x"].as_array().unwrap().len();
    let x = Tensor::<2>::from_data(TensorData::new(xs.clone(), [rows, xs.len() / rows]), &Device::flex());
    let y = values(activation::log_softmax(x, 1));
    assert!(relative_error(&y, &numbers(&golden["y"])) <= TOLERANCE);
}
