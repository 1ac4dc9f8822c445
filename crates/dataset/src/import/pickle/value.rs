//! Values of a pickle as what one expects of them: a dict, text, a number.

use super::globals::{Class, Dtype};
use super::{Id, Node, Pickle};
use crate::error::{DatasetError, Result};

/// A value of a pickle.
#[derive(Clone, Copy)]
pub(in crate::import) struct Item<'a> {
    pub(super) pickle: &'a Pickle,
    id: Id,
}

impl<'a> Item<'a> {
    pub(super) fn new(pickle: &'a Pickle, id: Id) -> Self {
        Self { pickle, id }
    }

    pub(super) fn node(self) -> &'a Node {
        &self.pickle.nodes[self.id as usize]
    }

    pub(super) fn other(self, id: Id) -> Self {
        Self { id, ..self }
    }

    /// The entry `key` of a dict; `place` names the dict in errors.
    pub fn get(self, key: &str, place: &str) -> Result<Self> {
        let entries = self.entries(place)?;
        let found = entries
            .iter()
            .rev()
            .find(|(k, _)| k.text().as_deref() == Some(key));
        if let Some((_, value)) = found {
            return Ok(*value);
        }
        let mut keys: Vec<_> = entries.iter().map(|(key, _)| key.describe()).collect();
        keys.truncate(12);
        let found = format!("only {}", keys.join(", "));
        Err(self.invalid(place, format!("an entry \"{key}\""), found))
    }

    /// The entries of a dict (or of an instance's state), in the file's order.
    pub fn entries(self, place: &str) -> Result<Vec<(Self, Self)>> {
        match self.node() {
            Node::Dict(entries) => Ok(entries
                .iter()
                .map(|&(key, value)| (self.other(key), self.other(value)))
                .collect()),
            &Node::Object(_, Some(state)) => match self.other(state).node() {
                Node::Dict(_) => self.other(state).entries(place),
                _ => Err(self.invalid(place, "a state with entries", self.describe())),
            },
            _ => Err(self.invalid(place, "a dict", self.describe())),
        }
    }

    pub fn is_dict(self) -> bool {
        matches!(self.node(), Node::Dict(_))
    }

    /// Short text.
    pub fn text(self) -> Option<String> {
        match self.node() {
            Node::Str(stored) => stored.text(),
            _ => None,
        }
    }

    /// A whole number, numpy's included.
    pub fn int(self) -> Option<i64> {
        match *self.node() {
            Node::Int(value) => Some(value),
            Node::Float(value) if value.fract() == 0.0 && value.abs() < 2f64.powi(53) => {
                Some(value as i64)
            }
            _ => None,
        }
    }

    /// A sparse matrix (scipy csc) instead of an array.
    pub fn is_sparse(self) -> bool {
        matches!(self.node(), Node::Object(Class::CscMatrix, _))
    }

    /// Error about this value.
    pub fn invalid(
        self,
        place: &str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> DatasetError {
        self.pickle.invalid(place, expected, found)
    }

    /// What it is, in a few words.
    pub fn describe(self) -> String {
        self.node().describe()
    }
}

impl Node {
    /// What it is, in a few words.
    pub(super) fn describe(&self) -> String {
        match self {
            Node::None => "None".into(),
            Node::Bool(value) => value.to_string(),
            Node::Int(value) => value.to_string(),
            Node::Float(value) => value.to_string(),
            Node::Str(stored) => match stored.text() {
                Some(text) if text.len() <= 40 => format!("{text:?}"),
                _ => format!("a string of {} bytes", stored.len()),
            },
            Node::Tuple(items) => format!("a tuple of {}", items.len()),
            Node::List(items) => format!("a list of {}", items.len()),
            Node::Dict(entries) => format!("a dict of {}", entries.len()),
            Node::Class(class) => format!("the name {class:?}"),
            Node::Dtype(Dtype { name, .. }) => format!("the dtype {name}"),
            Node::Array(array) => format!("an array of shape {:?}", array.shape),
            Node::Object(class, _) => format!("an instance of {class:?}"),
        }
    }
}
