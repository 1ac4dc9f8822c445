//! The stack machine: values, stack and memo.

use std::collections::HashMap;

use super::globals::Class;
use super::source::{Fault, Source, Stored};
use super::{ArrayNode, Id, MEMORY_LIMIT, Node};

/// A pickle being read.
pub(super) struct Machine {
    pub source: Source,
    nodes: Vec<Node>,
    stack: Vec<Id>,
    /// Heights of the stack at the open marks.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
    memory: usize,
}

impl Machine {
    pub fn new(source: Source) -> Self {
        Self {
            source,
            nodes: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
            memory: 0,
        }
    }

    /// All values and the number of the last one.
    pub fn run(mut self) -> Result<(Vec<Node>, Id), Fault> {
        while self.step()? {}
        let root = self.pop("the pickled value")?;
        Ok((self.nodes, root))
    }

    /// Puts a new value on the stack.
    pub fn push(&mut self, node: Node) -> Result<(), Fault> {
        let inside = match &node {
            Node::Str(stored) => stored.memory(),
            Node::Tuple(items) | Node::List(items) => items.capacity() * size_of::<Id>(),
            Node::Dict(entries) => entries.capacity() * size_of::<(Id, Id)>(),
            Node::Dtype(dtype) => dtype.name.capacity(),
            Node::Array(array) => size_of::<ArrayNode>() + array.shape.capacity() * 8,
            _ => 0,
        };
        self.count(size_of::<Node>() + inside)?;
        self.stack.push(self.nodes.len() as Id);
        self.nodes.push(node);
        Ok(())
    }

    /// Counts memory, and refuses to take more than the limit.
    pub fn count(&mut self, bytes: usize) -> Result<(), Fault> {
        self.memory = self.memory.saturating_add(bytes);
        if self.memory > MEMORY_LIMIT {
            let expected = format!("values of at most {} MB", MEMORY_LIMIT >> 20);
            return self.source.fault(expected, "more");
        }
        Ok(())
    }

    /// Puts a value on the stack again.
    pub fn repeat(&mut self, id: Id) -> Result<(), Fault> {
        self.count(size_of::<Id>())?;
        self.stack.push(id);
        Ok(())
    }

    /// Takes the top of the stack, not reaching below an open mark.
    pub fn pop(&mut self, what: &str) -> Result<Id, Fault> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.len() > floor {
            true => Ok(self.stack.pop().expect("the stack is above its floor")),
            false => self.source.fault(what, "an empty stack"),
        }
    }

    pub fn top(&mut self, what: &str) -> Result<Id, Fault> {
        let id = self.pop(what)?;
        self.stack.push(id);
        Ok(id)
    }

    pub fn mark(&mut self) -> Result<(), Fault> {
        self.count(size_of::<usize>())?;
        self.marks.push(self.stack.len());
        Ok(())
    }

    /// Takes everything above the last mark, and the mark.
    pub fn pop_to_mark(&mut self) -> Result<Vec<Id>, Fault> {
        match self.marks.pop() {
            Some(mark) => Ok(self.stack.split_off(mark)),
            None => self.source.fault("a mark on the stack", "none"),
        }
    }

    pub fn remember(&mut self, key: u32) -> Result<(), Fault> {
        let id = self.top("a value to remember")?;
        self.count(2 * size_of::<(u32, Id)>())?;
        self.memo.insert(key, id);
        Ok(())
    }

    pub fn remember_next(&mut self) -> Result<(), Fault> {
        self.remember(self.memo.len() as u32)
    }

    pub fn recall(&mut self, key: u32) -> Result<(), Fault> {
        match self.memo.get(&key) {
            Some(&id) => self.repeat(id),
            None => self
                .source
                .fault("a remembered value", format!("no number {key}")),
        }
    }

    /// Adds items to the list (or set) below them.
    pub fn extend_list(&mut self, items: &[Id]) -> Result<(), Fault> {
        self.count(2 * std::mem::size_of_val(items))?;
        let list = self.top("a list")?;
        match &mut self.nodes[list as usize] {
            Node::List(list) => {
                list.extend(items);
                Ok(())
            }
            _ => self.source.fault("a list to append to", self.name_of(list)),
        }
    }

    /// Adds keys and values, in turns, to the dict below them.
    pub fn extend_dict(&mut self, items: &[Id]) -> Result<(), Fault> {
        self.count(2 * std::mem::size_of_val(items))?;
        let (pairs, rest) = items.as_chunks::<2>();
        let dict = self.top("a dict")?;
        match &mut self.nodes[dict as usize] {
            Node::Dict(entries) if rest.is_empty() => {
                entries.extend(pairs.iter().map(|&[key, value]| (key, value)));
                Ok(())
            }
            Node::Dict(_) => self.source.fault("a value for each key", "a key alone"),
            _ => self.source.fault("a dict to add to", self.name_of(dict)),
        }
    }

    /// Puts a name on the stack that the reader knows.
    pub fn push_class(&mut self, module: &str, name: &str) -> Result<(), Fault> {
        match Class::of(module, name) {
            Some(class) => self.push(Node::Class(class)),
            None => self.source.fault(
                "only numpy arrays, scipy csc matrices, chumpy arrays, dicts, lists, text and numbers",
                format!(
                    "the name \"{}.{}\", which could be anything and is refused \
                     (if you trust the file: load it in Python and pickle plain arrays)",
                    module.escape_default(),
                    name.escape_default()
                ),
            ),
        }
    }

    /// Text on the stack, short enough for a name.
    pub fn pop_text(&mut self, what: &str) -> Result<String, Fault> {
        let id = self.pop(what)?;
        match self.text(id) {
            Some(text) => Ok(text),
            None => self.source.fault(what, self.name_of(id)),
        }
    }

    pub fn replace(&mut self, id: Id, node: Node) {
        self.nodes[id as usize] = node;
    }

    pub fn node(&self, id: Id) -> &Node {
        &self.nodes[id as usize]
    }

    pub fn class(&self, id: Id) -> Option<Class> {
        match self.node(id) {
            Node::Class(class) => Some(*class),
            _ => None,
        }
    }

    pub fn text(&self, id: Id) -> Option<String> {
        match self.node(id) {
            Node::Str(stored) => stored.text(),
            _ => None,
        }
    }

    pub fn name_of(&self, id: Id) -> String {
        self.node(id).describe()
    }

    /// A string value.
    pub fn push_string(&mut self, len: u64, utf8: bool) -> Result<(), Fault> {
        let stored = self.source.string(len, utf8)?;
        self.push(Node::Str(stored))
    }

    /// A string value that the file spells out.
    pub fn push_spelled(&mut self, bytes: Vec<u8>, utf8: bool) -> Result<(), Fault> {
        self.push(Node::Str(Stored::here(bytes, utf8)))
    }
}
