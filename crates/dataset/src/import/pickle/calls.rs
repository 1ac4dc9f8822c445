//! What a call of a known name, and a state for a known value, mean.

use super::globals::{Class, Dtype};
use super::machine::Machine;
use super::source::Fault;
use super::{ArrayNode, Id, Node};

/// numpy allows no more.
const MAX_DIMENSIONS: usize = 64;

impl Machine {
    /// `class(*arguments)`: what Python would make.
    pub fn call(&mut self) -> Result<(), Fault> {
        let arguments = self.pop("arguments")?;
        let callee = self.pop("a name to call")?;
        let (Node::Class(class), Node::Tuple(arguments)) =
            (self.node(callee), self.node(arguments))
        else {
            let found = format!("{} of {}", self.name_of(callee), self.name_of(arguments));
            return self.source.fault("a name called with a tuple", found);
        };
        let (class, arguments) = (*class, arguments.clone());
        let node = match (class, &arguments[..]) {
            (Class::Reconstruct, &[of, _, _]) if self.class(of) == Some(Class::NdArray) => {
                Some(Node::Array(Box::new(ArrayNode {
                    shape: Vec::new(),
                    dtype: Dtype::parse("f8"),
                    fortran: false,
                    data: None,
                })))
            }
            (Class::Dtype, &[name] | &[name, _] | &[name, _, _]) => {
                self.text(name).map(|n| Node::Dtype(Dtype::parse(&n)))
            }
            (Class::Scalar, &[dtype, data]) => self.scalar(dtype, data),
            (Class::FromBuffer, &[data, dtype, shape, order]) => {
                let fortran = self.text(order).map(|order| order == "F");
                fortran.and_then(|fortran| self.array(shape, dtype, fortran, data))
            }
            // The same string, read as bytes by whoever needs bytes.
            (Class::Encode, &[text, encoding])
                if matches!(self.node(text), Node::Str(_))
                    && matches!(self.text(encoding).as_deref(), Some("latin1" | "latin-1")) =>
            {
                return self.repeat(text);
            }
            (Class::OrderedDict, &[]) => Some(Node::Dict(Vec::new())),
            (Class::OrderedDict, &[pairs]) => self.pairs(pairs).map(Node::Dict),
            (Class::DefaultDict, &[of]) if self.class(of).is_some() => Some(Node::Dict(Vec::new())),
            (Class::Set, &[items]) if matches!(self.node(items), Node::List(_)) => {
                return self.repeat(items);
            }
            (Class::NewInstance, &[of, base, _]) if self.class(base) == Some(Class::Object) => {
                return self.instance(of);
            }
            _ => None,
        };
        match node {
            Some(node) => self.push(node),
            None => {
                let found: Vec<_> = arguments.iter().map(|&id| self.name_of(id)).collect();
                let found = format!("({})", found.join(", "));
                self.source
                    .fault(format!("arguments that fit {class:?}"), found)
            }
        }
    }

    /// `class.__new__(class, *arguments)`.
    pub fn new_object(&mut self) -> Result<(), Fault> {
        self.pop("arguments")?;
        let class = self.pop("a class")?;
        self.instance(class)
    }

    fn instance(&mut self, id: Id) -> Result<(), Fault> {
        match self.class(id) {
            Some(class) if class.has_instances() => self.push(Node::Object(class, None)),
            _ => self
                .source
                .fault("a class with instances", self.name_of(id)),
        }
    }

    /// Gives the value below its state.
    pub fn set_state(&mut self) -> Result<(), Fault> {
        let state = self.pop("a state")?;
        let target = self.top("a value to set the state of")?;
        let new = match (self.node(target), self.node(state)) {
            (Node::Array(_), Node::Tuple(items)) => match items[..] {
                // Version, shape, type, order, bytes.
                [_, shape, dtype, order, data] => match *self.node(order) {
                    Node::Bool(fortran) => self.array(shape, dtype, fortran, data),
                    Node::Int(fortran) => self.array(shape, dtype, fortran != 0, data),
                    _ => None,
                },
                _ => None,
            },
            (Node::Dtype(dtype), Node::Tuple(items)) => {
                let order = items.get(1).and_then(|&id| self.text(id));
                order.map(|order| {
                    Node::Dtype(Dtype {
                        big_endian: order == ">",
                        ..dtype.clone()
                    })
                })
            }
            (&Node::Object(class, _), Node::Dict(_)) => Some(Node::Object(class, Some(state))),
            _ => None,
        };
        match new {
            Some(node) => {
                self.count(size_of::<ArrayNode>())?;
                self.replace(target, node);
                Ok(())
            }
            None => {
                let found = format!("{} for {}", self.name_of(state), self.name_of(target));
                self.source.fault("a state that fits its value", found)
            }
        }
    }

    fn array(&self, shape: Id, dtype: Id, fortran: bool, data: Id) -> Option<Node> {
        let (Node::Tuple(shape), Node::Dtype(dtype)) = (self.node(shape), self.node(dtype)) else {
            return None;
        };
        if shape.len() > MAX_DIMENSIONS {
            return None;
        }
        // A list of objects instead of bytes: fine as long as nobody reads it.
        matches!(self.node(data), Node::Str(_) | Node::List(_)).then_some(())?;
        let size = |&id: &Id| match *self.node(id) {
            Node::Int(n) => u64::try_from(n).ok(),
            _ => None,
        };
        let shape = shape.iter().map(size).collect::<Option<_>>()?;
        Some(Node::Array(Box::new(ArrayNode {
            shape,
            dtype: dtype.clone(),
            fortran,
            data: Some(data),
        })))
    }

    fn scalar(&self, dtype: Id, data: Id) -> Option<Node> {
        let (Node::Dtype(dtype), Node::Str(data)) = (self.node(dtype), self.node(data)) else {
            return None;
        };
        let number = dtype.number?;
        let bytes = data.short_bytes()?;
        if bytes.len() != number.size() {
            return None;
        }
        let value = number.read(&bytes, dtype.big_endian);
        Some(if number.is_integer() && value.abs() < 2f64.powi(53) {
            Node::Int(value as i64)
        } else {
            Node::Float(value)
        })
    }

    fn pairs(&self, id: Id) -> Option<Vec<(Id, Id)>> {
        let Node::List(items) = self.node(id) else {
            return None;
        };
        let pair = |&id: &Id| match self.node(id) {
            Node::List(pair) | Node::Tuple(pair) if pair.len() == 2 => Some((pair[0], pair[1])),
            _ => None,
        };
        items.iter().map(pair).collect()
    }
}
