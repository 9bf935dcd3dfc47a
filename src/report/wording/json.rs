//! Results as JSON: their own form, with a sentence for each code.

use serde::{Serialize, Serializer};
use serde_json::{Value, json};

use super::{
    candidate, change, columns, diagnosis, drift, limits, location, nameplate, next_run, probe,
    sanity, versus,
};
use drivebench_bench::column_proposal::Proposal;
use drivebench_diagnose::{
    AddResult, Comparison, Diagnosis, FailureLocation, Limit, NextExperiment, Versus,
};
use drivebench_identify::drift::{Change, Drift};
use drivebench_identify::nameplate::Comparison as Nameplate;
use drivebench_identify::sanity::Finding;
use drivebench_link::ProbeReport;

/// The form by its own serialiser.
fn own(found: &impl Serialize) -> Value {
    serde_json::to_value(found).unwrap_or_default()
}

/// Puts what is made of each element into the element of a list: mostly its sentence.
fn each<T, V: Into<Value>>(list: &mut Value, found: &[T], key: &str, made: impl Fn(&T) -> V) {
    for (value, found) in list.as_array_mut().into_iter().flatten().zip(found) {
        value[key] = made(found).into();
    }
}

/// Codes with their sentences.
fn coded<T: Serialize>(found: &[T], sentence: impl Fn(&T) -> String) -> Value {
    found.iter().map(|own| json!({"code": own, "sentence": sentence(own)})).collect()
}

fn locations(list: &mut Value, found: &[FailureLocation]) {
    each(list, found, "sentence", location::location);
}

/// Limits as sentences, and their codes.
fn limit_list(value: &mut Value, found: &[Limit]) {
    value["limits"] = found.iter().map(limits::limit).collect();
    value["limit_codes"] = found.iter().map(Limit::code).collect();
}

pub fn diagnosis(found: &Diagnosis) -> Value {
    let mut value = own(found);
    value["code"] = found.answer().code().into();
    value["sentence"] = diagnosis::diagnosis(found).into();
    if let Some(reason) = &found.reason {
        value["reason"] = limits::trivial(reason).into();
        value["reason_code"] = reason.code().into();
    }
    limit_list(&mut value, &found.limits);
    each(&mut value["candidates"], &found.candidates, "evidence", candidate::evidence);
    each(&mut value["unknown"], &found.unknown, "sentence", diagnosis::unknown);
    if !found.repeat_follows.is_empty() {
        locations(&mut value["repeat_follows"], &found.repeat_follows);
    }
    if !found.axis_map.is_empty() {
        each(&mut value["axis_map"], &found.axis_map, "sentence", location::axis_map);
    }
    if let Some(confirm) = &found.confirm {
        value["confirm"]["sentence"] = diagnosis::confirmation(found, confirm).into();
    }
    if let Some(next) = &found.next_experiment {
        value["next_experiment"] = next_experiment(next);
    }
    value
}

fn next_experiment(next: &NextExperiment) -> Value {
    let mut value = own(next);
    value["sentence"] = next_run::next_run(next).into();
    each(&mut value["hidden"], &next.hidden, "reason", next_run::hidden_reason);
    value
}

pub fn comparison(found: &Comparison) -> Value {
    let mut value = own(found);
    if let Some(reason) = &found.not_fitted {
        value["not_fitted"] = limits::trivial(reason).into();
        value["not_fitted_code"] = reason.code().into();
    }
    limit_list(&mut value, &found.limits);
    locations(&mut value["where"], &found.locations);
    each(&mut value["balances"], &found.balances, "sentence", |own| {
        location::balance(own, &found.locations)
    });
    if let Some(torque) = &found.signals.torque_n_m {
        let list = &mut value["signals"]["torque_n_m"]["processing"];
        each(list, &torque.processing, "sentence", |own| limits::derivation(&own.derivation));
    }
    value
}

pub fn change(found: &AddResult) -> Value {
    let mut value = own(found);
    value["reason"] = change::change(found).into();
    for (key, side) in [("before", &found.before), ("after", &found.after)] {
        value[key] = comparison(side);
    }
    value
}

pub fn versus(found: &Versus) -> Value {
    let mut value = own(found);
    value["sentence"] = versus::versus(found).into();
    value
}

pub fn drift(found: &Drift) -> Value {
    let mut value = own(found);
    value["sentence"] = drift::drift(found).into();
    value["caution"] = drift::caution(found).into();
    let changes = &mut value["changes"];
    each(changes, &found.changes, "sentence", |own| drift::change(own, &found.since));
    let cause = |own: &Change| own.possible_cause.as_ref().map(drift::cause);
    each(changes, &found.changes, "possible_cause", cause);
    each(&mut value["not_compared"], &found.not_compared, "reason", drift::not_compared);
    value
}

pub fn sanity(found: &[Finding]) -> Value {
    let mut list = own(&found);
    each(&mut list, found, "sentence", |finding| sanity::fault(&finding.fault));
    each(&mut list, &sanity::helps(found), "help", String::clone);
    list
}

pub fn map(found: &Proposal) -> Value {
    let mut value = own(found);
    let items = &mut value["items"];
    each(items, &found.items, "reasons", |item| coded(&item.reasons, columns::reason));
    each(items, &found.items, "doubts", |item| coded(&item.doubts, columns::doubt));
    value["missing"] = coded(&found.missing, columns::missing);
    value["doubts"] = coded(&found.doubts, sanity::fault);
    value["unused"] = coded(&found.unused, columns::unused);
    value["confidence"] = json!(found.confidence());
    value["settled"] = found.is_settled().into();
    value
}

pub fn probe(found: &ProbeReport) -> Value {
    let mut value = own(found);
    value["sentence"] = probe::probe(found).into();
    value
}

pub fn nameplate(found: &Nameplate) -> Value {
    let mut value = own(found);
    value["code"] = found.finding().code().into();
    value["causes"] = found.causes.iter().map(nameplate::cause).collect();
    if let Some(doubt) = &found.doubt {
        value["doubt"] = nameplate::doubt(doubt).into();
    }
    each(&mut value["rows"], &found.rows, "sentence", nameplate::row);
    each(&mut value["rows"], &found.rows, "code", |own| own.finding().code());
    value
}

/// The forms as serialisers of fields of other results, each also of a field that may be empty.
macro_rules! of_fields {
    ($($serializer:ident: $form:ident of $found:ty;)*) => {$(
        pub(crate) fn $serializer<'a, S: Serializer>(
            found: impl Into<Option<&'a $found>>,
            serializer: S,
        ) -> Result<S::Ok, S::Error> {
            found.into().map($form).serialize(serializer)
        }
    )*};
}

of_fields! {
    with_sentences: diagnosis of Diagnosis;
    compared: comparison of Comparison;
    of_both: versus of Versus;
    plate: nameplate of Nameplate;
    drifted: drift of Drift;
}
