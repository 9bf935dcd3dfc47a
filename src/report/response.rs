//! The frequency response of a pathway as a chart: magnitude, phase and coherence of measurement and model.

use super::plot::{AxisChart, AxisPanel, Drawn, Place, PointSet, Style};
use drivebench_identify::frequency_response::{
    CARRIED, Compared, Mode, Pathway, PathwayResponse, ResponsePoint,
};
use drivebench_model::text::number::significant;

/// The position of a point in a panel.
type Of = fn(&ResponsePoint) -> Place;

fn magnitude_db(point: &ResponsePoint) -> Place {
    let [value, low, high] = [point.magnitude, point.magnitude_low, point.magnitude_high]
        .map(|value| 20.0 * value.log10());
    Place { at: point.frequency_hz, value, low, high }
}

fn phase_deg(point: &ResponsePoint) -> Place {
    let (value, half) = (point.phase_deg, point.phase_half_width_deg);
    Place { at: point.frequency_hz, value, low: value - half, high: value + half }
}

fn coherence(point: &ResponsePoint) -> Place {
    Place::new(point.frequency_hz, point.coherence, 0.0)
}

/// Without panels where the pathway was not measured.
pub fn response_chart(compared: &Compared, pathway: Pathway) -> AxisChart {
    let Some(own) = compared.measured.of(pathway) else {
        return AxisChart::default();
    };
    let bands = own.bands_hz();
    let first_hz = bands.first().map_or(f64::INFINITY, |band| band.0);
    let last_hz = bands.last().map_or(0.0, |band| band.1);
    let predicted = compared.model.as_ref().and_then(|model| model.of(pathway));
    let set = |of: &PathwayResponse, label: &str, style, drawn, place: Of| {
        let is_shown = |point: &ResponsePoint| match (style, drawn) {
            (_, Drawn::Faint) => !point.is_carried,
            (Style::Measured, _) => point.is_carried,
            // Outside the carried bands there is nothing to compare the model with.
            _ => point.is_carried && (first_hz..=last_hz).contains(&point.frequency_hz),
        };
        let points = of.points.iter().map(|point| {
            let value = if is_shown(point) { place(point).value } else { f64::NAN };
            Place { value, ..place(point) }
        });
        PointSet { label: label.to_owned(), style, drawn, points: points.collect() }
    };
    let panel =
        |title: String, height, place: Of, holds: &[f64], predicted: Option<&PathwayResponse>| {
            let mut sets = vec![
                set(own, "", Style::Measured, Drawn::Faint, place),
                set(own, "measured", Style::Measured, Drawn::Curve, place),
            ];
            sets.extend(
                predicted.map(|model| set(model, "model", Style::Before, Drawn::Curve, place)),
            );
            AxisPanel { title, height, holds: holds.to_vec(), sets, ..AxisPanel::default() }
        };
    let magnitude = format!("magnitude, dB of 1 {}", own.unit);
    let coherent = format!("coherence, carried from {CARRIED}");
    let modes = compared.measured.modes_of(pathway).into_iter();
    let name = |mode: &Mode| {
        let hertz = significant(mode.frequency_hz, 3);
        format!("{} {hertz} Hz", mode.kind.name())
    };
    AxisChart {
        axis: "frequency, Hz".to_owned(),
        unit: "Hz",
        is_logarithmic: true,
        panels: vec![
            panel(magnitude, 180.0, magnitude_db, &[], predicted),
            panel("phase, degrees".to_owned(), 140.0, phase_deg, &[], predicted),
            panel(coherent, 100.0, coherence, &[0.0, 1.0], None),
        ],
        marks: modes.map(|mode| (name(&mode), mode.frequency_hz)).collect(),
    }
}
