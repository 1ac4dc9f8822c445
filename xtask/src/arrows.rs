//! Checks the arrows between crates: the table in ARCHITECTURE.md is the list
//! of allowed dependencies, `cargo metadata` tells the real ones, and both must
//! be the same. Crates that must stay free of tensors are checked with all
//! their dependencies.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
};

use anyhow::{Context, Result, anyhow, bail};
use serde_json::Value;

use crate::program::{cargo, workspace};

/// Crates whose dependency trees never hold candle.
const WITHOUT_TENSORS: [&str; 5] = [
    "drape-geometry",
    "drape-dataset",
    "drape-sim",
    "drape-view",
    "xtask",
];

type Arrows = BTreeMap<String, BTreeSet<String>>;

/// Compares the workspace's arrows with ARCHITECTURE.md.
pub fn check() -> Result<()> {
    let path = workspace().join("ARCHITECTURE.md");
    let text =
        fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let output = cargo()
        .args(["metadata", "--format-version", "1", "--locked"])
        .output()
        .context("cannot run cargo metadata")?;
    if !output.status.success() {
        bail!(
            "cargo metadata failed:\n{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    let metadata: Value = serde_json::from_slice(&output.stdout)
        .context("cannot read the output of cargo metadata")?;

    let mut problems = differences(&written_arrows(&text)?, &real_arrows(&metadata)?);
    problems.extend(tensors_reached(&metadata)?);
    if problems.is_empty() {
        Ok(())
    } else {
        bail!("{}", problems.join("\n"))
    }
}

/// Rows `` | `crate` | `dependency`, `dependency` | … `` of the table under the heading "Arrows".
fn written_arrows(text: &str) -> Result<Arrows> {
    let section = text
        .split("\n## ")
        .find(|section| section.starts_with("Arrows"))
        .ok_or_else(|| anyhow!("ARCHITECTURE.md has no section `## Arrows`"))?;
    let rows: Arrows = section
        .lines()
        .filter_map(|line| {
            let mut cells = line.strip_prefix('|')?.split('|');
            let name = code_spans(cells.next()?).into_iter().next()?;
            Some((name, code_spans(cells.next()?)))
        })
        .collect();
    if rows.is_empty() {
        bail!("the section `## Arrows` of ARCHITECTURE.md has no table of crates");
    }
    Ok(rows)
}

fn code_spans(cell: &str) -> BTreeSet<String> {
    cell.split('`')
        .skip(1)
        .step_by(2)
        .map(str::to_owned)
        .collect()
}

/// Dependencies between workspace members, of any kind.
fn real_arrows(metadata: &Value) -> Result<Arrows> {
    let members: BTreeSet<&str> = array(metadata, "workspace_members")?
        .iter()
        .filter_map(Value::as_str)
        .collect();
    let packages: Vec<&Value> = array(metadata, "packages")?
        .iter()
        .filter(|package| {
            package["id"]
                .as_str()
                .is_some_and(|id| members.contains(id))
        })
        .collect();
    let names: BTreeSet<String> = packages
        .iter()
        .filter_map(|package| text(package, "name"))
        .collect();
    packages
        .iter()
        .map(|package| {
            let name = text(package, "name")
                .ok_or_else(|| anyhow!("a package without a name in cargo metadata"))?;
            let to = array(package, "dependencies")?
                .iter()
                .filter_map(|dependency| text(dependency, "name"))
                .filter(|dependency| names.contains(dependency))
                .collect();
            Ok((name, to))
        })
        .collect()
}

fn differences(written: &Arrows, real: &Arrows) -> Vec<String> {
    let crates: BTreeSet<&String> = written.keys().chain(real.keys()).collect();
    crates
        .into_iter()
        .flat_map(|name| {
            let (Some(allowed), Some(used)) = (written.get(name), real.get(name)) else {
                let place = if real.contains_key(name) {
                    "ARCHITECTURE.md"
                } else {
                    "the workspace"
                };
                return vec![format!("crate {name} is missing in {place}")];
            };
            let forbidden = used.difference(allowed).map(|to| {
                format!("{name} depends on {to}, which the table in ARCHITECTURE.md does not allow")
            });
            let stale = allowed.difference(used).map(|to| {
                format!(
                    "ARCHITECTURE.md says that {name} depends on {to}, but its Cargo.toml does not"
                )
            });
            forbidden.chain(stale).collect()
        })
        .collect()
}

/// Crates of [`WITHOUT_TENSORS`] that reach candle, through normal and build dependencies.
fn tensors_reached(metadata: &Value) -> Result<Vec<String>> {
    let mut edges: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for node in array(&metadata["resolve"], "nodes")? {
        let to = array(node, "deps")?
            .iter()
            .filter(|dependency| {
                dependency["dep_kinds"]
                    .as_array()
                    .is_none_or(|kinds| kinds.iter().any(|kind| kind["kind"] != "dev"))
            })
            .filter_map(|dependency| dependency["pkg"].as_str())
            .collect();
        edges.insert(node["id"].as_str().unwrap_or_default(), to);
    }
    let names: BTreeMap<&str, String> = array(metadata, "packages")?
        .iter()
        .filter_map(|package| Some((package["id"].as_str()?, text(package, "name")?)))
        .collect();
    let mut problems = Vec::new();
    for (id, name) in &names {
        if !WITHOUT_TENSORS.contains(&name.as_str()) {
            continue;
        }
        let mut seen = BTreeSet::new();
        let mut open = vec![*id];
        while let Some(next) = open.pop() {
            if seen.insert(next) {
                open.extend(edges.get(next).into_iter().flatten());
            }
        }
        if let Some(candle) = seen
            .iter()
            .filter_map(|id| names.get(id))
            .find(|name| name.starts_with("candle"))
        {
            problems.push(format!(
                "{name} must not need tensors, but {candle} is in its dependency tree"
            ));
        }
    }
    Ok(problems)
}

fn array<'a>(value: &'a Value, key: &str) -> Result<&'a Vec<Value>> {
    value[key]
        .as_array()
        .ok_or_else(|| anyhow!("cargo metadata has no list `{key}`"))
}

fn text(value: &Value, key: &str) -> Option<String> {
    value[key].as_str().map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &str = "# x\n\n## Arrows\n\n| crate | may use |\n|---|---|\n| `a` | – |\n| `b` | `a`, `c` |\n\n## Next\n| `d` | `a` |\n";

    fn arrows(list: &[(&str, &[&str])]) -> Arrows {
        list.iter()
            .map(|(from, to)| {
                (
                    from.to_string(),
                    to.iter().map(ToString::to_string).collect(),
                )
            })
            .collect()
    }

    #[test]
    fn only_the_table_under_its_heading_is_read() {
        assert_eq!(
            written_arrows(TABLE).unwrap(),
            arrows(&[("a", &[]), ("b", &["a", "c"])])
        );
    }

    #[test]
    fn forbidden_stale_and_unknown_are_each_reported() {
        let written = arrows(&[("a", &[]), ("b", &["a"]), ("gone", &[])]);
        let real = arrows(&[("a", &["b"]), ("b", &[]), ("new", &[])]);
        let problems = differences(&written, &real);
        assert_eq!(problems.len(), 4, "{problems:#?}");
        assert!(problems[0].contains("a depends on b"));
        assert!(problems[1].contains("says that b depends on a"));
        assert!(problems[2].contains("gone is missing in the workspace"));
        assert!(problems[3].contains("new is missing in ARCHITECTURE.md"));
        assert!(differences(&written, &written).is_empty());
    }
}
