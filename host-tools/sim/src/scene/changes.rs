//! Changes to a scene before it is read: the reference finger, and single keys.

use scan_plan::STEPS;
use scan_plan::finger::REFERENCE;
use serde::Deserialize;
use taxel_files::FileError;
use toml::{Table, Value};

use super::Scene;

/// Effects of a real finger, all of which the reference finger has.
pub const REAL: [&str; 18] = [
    "noise",
    "ambient",
    "flicker",
    "settling",
    "gain-spread",
    "optical-crosstalk",
    "bridge-mismatch",
    "bridge-crosstalk",
    "walls",
    "stiffening",
    "hysteresis",
    "skin-response",
    "response",
    "creep",
    "self-heating",
    "nonlinearity",
    "diffuse-facet",
    "bench-error",
];

/// Changes to a scene.
#[derive(Clone, Debug, Default)]
pub struct Changes {
    /// Whether the finger is the reference finger: its parts, where the scene gives none, and
    /// [`REAL`].
    pub reference: bool,
    /// Keys with their values, such as `material.young_mpa=0.3` or `effects.walls=false`; an empty
    /// value leaves the key out.
    pub set: Vec<String>,
}

impl Scene {
    /// Loads a scene as [`Scene::load`] does, with changes.
    ///
    /// # Errors
    /// The scene or a change is not valid; the message is one line.
    pub fn load_changed(name_or_path: &str, changes: &Changes) -> Result<Self, FileError> {
        let (path, text) = super::read::text_of(name_or_path)?;
        Self::parse_changed(&path, &text, changes)
    }

    /// Parses a scene as [`Scene::parse`] does, with changes.
    ///
    /// # Errors
    /// Those of [`Self::load_changed`].
    pub fn parse_changed(path: &str, text: &str, changes: &Changes) -> Result<Self, FileError> {
        let scene = Self::parse(path, text)?;
        if !changes.reference && changes.set.is_empty() {
            return Ok(scene);
        }
        let error = |problem: String| FileError::new(path, problem);
        let mut table: Table = toml::from_str(text).map_err(|e| error(e.to_string()))?;
        if changes.reference {
            if scene.device.kind != super::Kind::Taxel4x4 {
                return Err(error("only a `taxel-4x4` has a reference finger".to_owned())
                    .mend("leave `--finger reference` away"));
            }
            make_reference(&mut table);
        }
        for change in &changes.set {
            set(&mut table, change)
                .map_err(|problem| error(format!("--set {change}: {problem}")))?;
        }
        let text = toml::to_string(&table).map_err(|e| error(e.to_string()))?;
        let path = format!("{} with --finger or --set", path.trim_end_matches(".toml"));
        Self::parse(path, &text)
    }
}

/// Adds the reference finger's parts where the scene has none, and its effects.
fn make_reference(table: &mut Table) {
    let (converter, column) = (REFERENCE.converter, REFERENCE.column);
    // The board spreads its steps over the scan, and a slower stream takes some of its scans.
    let rate = table.get("scan").and_then(|scan| scan.get("rate_hz")).and_then(Value::as_integer);
    let scan_hz = i64::from(converter.scan_hz).max(rate.unwrap_or(0));
    let parts: [(&str, &str, Value); 7] = [
        ("layer", "gap_mm", REFERENCE.pair.gap_mm.into()),
        ("electronics", "load_ohm", column.feedback_ohm.into()),
        ("electronics", "pga_gain", 1.into()),
        ("electronics", "time_constant_us", (1e6 * REFERENCE.time_constant_s()).into()),
        ("electronics", "oversampling", i64::from(converter.oversampling).into()),
        ("electronics", "reference_ratio", column.reference_ratio().into()),
        ("scan", "step_us", (1_000_000 / (i64::from(STEPS) * scan_hz)).into()),
    ];
    for (within, key, value) in parts {
        let part = table.entry(within).or_insert_with(|| Value::Table(Table::new()));
        if let Some(part) = part.as_table_mut() {
            part.entry(key).or_insert(value);
        }
    }
    REAL.iter().for_each(|effect| switch(table, effect, true));
}

/// Lists an effect, or takes it from the list.
fn switch(table: &mut Table, effect: &str, on: bool) {
    let list = table.entry("effects").or_insert_with(|| Value::Array(Vec::new()));
    let Some(list) = list.as_array_mut() else { return };
    list.retain(|listed| listed.as_str() != Some(effect));
    if on {
        list.push(effect.into());
    }
}

/// Applies one change, `KEY=VALUE`.
fn set(table: &mut Table, change: &str) -> Result<(), String> {
    let (key, value) = change.split_once('=').ok_or("expected KEY=VALUE")?;
    let (key, value) = (key.trim(), value.trim());
    if let Some(effect) = key.strip_prefix("effects.") {
        let on = value.parse().map_err(|_| format!("`{value}` is not true or false"))?;
        // To switch off what there is not would change nothing, without a word.
        super::Effect::deserialize(Value::from(effect)).map_err(|e| e.message().to_owned())?;
        switch(table, effect, on);
        return Ok(());
    }
    let read = |value: &str| toml::from_str::<Table>(&format!("v = {value}"));
    let value = match read(value) {
        Ok(mut read) => read.remove("v"),
        // A word needs no quotes.
        Err(_) => (!value.is_empty()).then(|| value.into()),
    };
    let (path, last) = key.rsplit_once('.').unwrap_or(("", key));
    let mut at = table;
    for name in path.split('.').filter(|name| !name.is_empty()) {
        let next = at.entry(name).or_insert_with(|| Value::Table(Table::new()));
        // A list, such as [[press]], stands for its first table.
        let next = match next {
            Value::Array(list) => list.first_mut(),
            other => Some(other),
        };
        at = next.and_then(Value::as_table_mut).ok_or_else(|| format!("`{name}` has no keys"))?;
    }
    match value {
        Some(value) => _ = at.insert(last.to_owned(), value),
        None if at.remove(last).is_some() => {}
        None => return Err(format!("there is no `{last}` to leave out")),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use scan_plan::g431;

    use super::*;
    use crate::Effect;

    fn changed(reference: bool, set: &[&str]) -> Result<Scene, FileError> {
        let set = set.iter().map(|s| (*s).to_owned()).collect();
        Scene::load_changed("press", &Changes { reference, set })
    }

    #[test]
    fn reference_finger_has_its_parts_and_effects() {
        let scene = changed(true, &[]).unwrap();
        assert_eq!(scene.effects.len(), REAL.len());
        assert!(scene.has(Effect::Walls) && scene.has(Effect::BenchError));
        assert_eq!(scene.layer.gap_mm, REFERENCE.pair.gap_mm);
        assert_eq!(scene.electronics.load_ohm, REFERENCE.column.feedback_ohm);
        let tau = 1e6 * REFERENCE.time_constant_s();
        assert!((scene.time_constant_us() - tau).abs() < 1e-9);
        assert_eq!(scene.oversampling(), REFERENCE.converter.oversampling);
        let plan = g431::plan(REFERENCE.converter.settings());
        assert_eq!(scene.scan.step_us(), plan.unwrap().step.frame_us() / STEPS);
        // The scene's own timing stays.
        assert_eq!(scene.rate_hz(), Scene::load("press").unwrap().rate_hz());
    }

    #[test]
    fn set_changes_keys_and_effects() {
        let scene = changed(true, &["effects.walls=false", "material.young_mpa=0.3"]).unwrap();
        assert!(!scene.has(Effect::Walls) && scene.has(Effect::Hysteresis));
        assert_eq!(scene.material.young_mpa, 0.3);
        let weak = changed(false, &["press.fz_n=0.5", "device.coating=rA"]).unwrap();
        assert_eq!(weak.acts().len(), Scene::load("press").unwrap().acts().len());
        assert_eq!(weak.press[0].get_ref().fz_n, 0.5);
        let idle = changed(false, &["press="]).unwrap();
        assert!(idle.acts().is_empty() && changed(false, &["press.fx_n="]).is_ok());
    }

    #[test]
    fn wrong_change_names_itself() {
        let said = |set: &str| changed(false, &[set]).unwrap_err().to_string();
        assert!(said("material.young=1").contains("young"), "{}", said("material.young=1"));
        assert!(said("effects.walls=maybe").contains("--set effects.walls=maybe"));
        let unknown = said("effects.wall=false");
        assert!(unknown.contains("`wall`") && unknown.contains("`walls`"), "{unknown}");
        assert!(said("scan").contains("expected KEY=VALUE"));
        assert!(said("press.fy_n=").contains("there is no `fy_n` to leave out"));
        let message = Scene::load_changed("micro-press", &Changes { reference: true, set: vec![] });
        assert!(message.unwrap_err().to_string().contains("reference finger"));
    }
}
