//! The gallery of effects: every effect of the catalogue at a typical size on the emulated motor of paper A, the equation's
//! error without it, and the effect drawn through the points. Writes `docs/gallery.md` and `docs/gallery/`.
//!
//! ```sh
//! cargo run --release --example gallery
//! ```
#![expect(clippy::print_stdout, reason = "the output of an example")]

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

use drivebench::diagnosis::{EffectCurve, effect_curve};
use drivebench::identification::noise::NoiseFloor;
use drivebench::identification::output_error::FitError;
use drivebench::plant::effect::{CATALOGUE, Card, ParameterRole};
use drivebench::plant::{ActiveEffect, Model, Motor, testing};
use drivebench::report::wording::location::{self, axis_name};
use drivebench::report::{curve_picture, plot};
use drivebench::text::number::{significant, with_unit};

/// Least ratio of the root mean squares of the error without and with an effect, so that its size exceeds the noise.
const VISIBLE_RATIO: f64 = 2.0;
/// Most doublings of the first guess.
const MOST_DOUBLINGS: u32 = 8;
const PERIOD_S: f64 = 0.002;
const DURATION_S: f64 = 12.0;
const SLEW_V_PER_S: f64 = 300.0;

/// Rest, a slow sine over both directions, then steps with reversals, low speeds and rests between them.
fn excitation() -> Vec<(f64, f64)> {
    let mut events = vec![(0.0, 0.0)];
    let ramp = (0..300).map(|k| {
        let turned = std::f64::consts::TAU * f64::from(k) / 300.0;
        (0.4 + 0.02 * f64::from(k), 90.0 * turned.sin())
    });
    events.extend(ramp);
    let levels =
        [30.0, 90.0, 50.0, 3.0, 0.0, -4.0, -40.0, -90.0, 60.0, -60.0, 6.0, 20.0, 0.0, 70.0];
    // The slew limit of the drive over 10 ms.
    let most_v = SLEW_V_PER_S * 0.01;
    let mut level_v: f64 = 0.0;
    for (k, wanted_v) in levels.into_iter().enumerate() {
        for step in 0..40 {
            level_v += (wanted_v - level_v).clamp(-most_v, most_v);
            events.push((6.4 + 0.4 * k as f64 + 0.01 * f64::from(step), level_v));
        }
    }
    events
}

/// The motor with the effect, and its curve, at the first of the doubled sizes that is visible.
fn drawn(
    effect: &'static dyn drivebench::plant::Effect,
) -> Result<Option<(Model, EffectCurve)>, FitError> {
    let mut last = None;
    for doublings in 0..=MOST_DOUBLINGS {
        let mut active = ActiveEffect::new(effect);
        let values = active.values_or_guess().into_iter().zip(effect.parameters());
        let values = values.map(|(value, spec)| match spec.role {
            ParameterRole::Coefficient => Some(value * f64::from(1 << doublings)),
            ParameterRole::EventTime => Some(0.6 * DURATION_S),
            _ => Some(value),
        });
        active.values = values.collect();
        let mut model = Model::baseline(Motor::zk_22fc());
        model.effects.push(active);
        let run = testing::record(&model, excitation(), PERIOD_S, DURATION_S, 1);
        let Some(noise) = NoiseFloor::from_standstill(&run) else {
            return Ok(None);
        };
        let Some(curve) = effect_curve(&model, effect.card().id, &run, &noise)? else {
            continue;
        };
        let with = curve.rms_with.unwrap_or(f64::INFINITY);
        let is_visible = curve.rms_without > VISIBLE_RATIO * with;
        last = Some((model, curve));
        if is_visible {
            break;
        }
    }
    Ok(last)
}

fn section(page: &mut String, card: &Card, found: Option<&(Model, EffectCurve)>) {
    let (id, name, equation) = (card.id, card.name, card.equation);
    let _ = write!(page, "\n## {name}\n\n`{id}`: `{equation}`\n\n");
    if let Some((model, curve)) = found {
        let sizes = model.effects.iter().flat_map(|active| {
            active.effect.parameters().iter().zip(&active.values).filter_map(|(spec, value)| {
                let size = with_unit(&significant((*value)?, 3), spec.unit);
                Some(format!("`{}` {size}", spec.key))
            })
        });
        let sizes = sizes.collect::<Vec<_>>().join(", ");
        let _ = write!(
            page,
            "![{name}: error of the {} equation over {}](gallery/{id}.svg)\n\nAt {sizes}: {}.",
            curve.equation,
            axis_name(curve),
            location::curve(curve)
        );
        if let Some(why) = location::why_axis(curve) {
            let _ = write!(page, " {why}.");
        }
    } else {
        page.push_str("There is no curve of it.");
    }
    let _ = write!(
        page,
        "\n\n- Causes: {}.\n- Looks like: {}.\n- Excited by: {}.\n- Remedy: {}.\n",
        card.causes, card.looks_like, card.excite, card.remedy
    );
}

/// Every file of the gallery with its path below `docs`.
///
/// # Errors
/// A motor that cannot be simulated.
pub fn gallery() -> Result<Vec<(String, String)>, FitError> {
    let mut page = String::from(
        "# Gallery of effects\n\n\
         The curve of each effect. The emulated motor of paper A has the effect, the model does not. Circles: error of the\n\
         equation without the effect; dots: with it; each is the mean of some windows with its 95 % interval; line: the effect. An\n\
         effect that is no curve over one axis is drawn along that with the largest share. `cargo run --release --example gallery`\n\
         writes this page; `drivebench diagnose --html` draws the same for your machine, and `drivebench effects` lists the effects.\n",
    );
    let mut files = Vec::new();
    for effect in CATALOGUE {
        let card = effect.card();
        let found = drawn(*effect)?;
        section(&mut page, card, found.as_ref());
        if let Some((_, curve)) = &found {
            let picture = plot::standalone(&curve_picture(curve));
            files.push((format!("gallery/{}.svg", card.id), picture));
        }
    }
    files.push(("gallery.md".to_owned(), page));
    Ok(files)
}

fn main() -> Result<(), Box<dyn Error>> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    std::fs::create_dir_all(docs.join("gallery"))?;
    for (name, text) in gallery()? {
        std::fs::write(docs.join(&name), text)?;
        println!("docs/{name}");
    }
    Ok(())
}
