//! The instructions, as `pickletools.py` of CPython lists them.

use super::Node;
use super::machine::Machine;
use super::source::Fault;

impl Machine {
    /// Does one instruction; false at the last one.
    pub fn step(&mut self) -> Result<bool, Fault> {
        let [opcode] = self.source.take("instructions")?;
        match opcode {
            b'.' => return Ok(false),
            // Protocol and frames.
            0x80 => match self.source.take::<1>("the protocol")? {
                [0..=5] => {}
                [newer] => return self.source.fault("protocol 0 to 5", newer.to_string()),
            },
            0x95 => {
                let len = self.u64("a frame's length")?;
                self.source.require(len, "a frame")?;
            }
            // The stack.
            b'(' => self.mark()?,
            b'0' => drop(self.pop("a value to drop")?),
            b'1' => drop(self.pop_to_mark()?),
            b'2' => {
                let id = self.top("a value to repeat")?;
                self.repeat(id)?;
            }
            // The memo.
            b'p' => self.line_number().and_then(|key| self.remember(key))?,
            b'q' => {
                let key = self.u8("a memo number")?;
                self.remember(key.into())?;
            }
            b'r' => self
                .u32("a memo number")
                .and_then(|key| self.remember(key))?,
            0x94 => self.remember_next()?,
            b'g' => self.line_number().and_then(|key| self.recall(key))?,
            b'h' => {
                let key = self.u8("a memo number")?;
                self.recall(key.into())?;
            }
            b'j' => self.u32("a memo number").and_then(|key| self.recall(key))?,
            // Numbers.
            b'N' => self.push(Node::None)?,
            0x88 => self.push(Node::Bool(true))?,
            0x89 => self.push(Node::Bool(false))?,
            b'K' => {
                let value = self.u8("an integer")?;
                self.push(Node::Int(value.into()))?;
            }
            b'M' => {
                let value = u16::from_le_bytes(self.source.take("an integer")?);
                self.push(Node::Int(value.into()))?;
            }
            b'J' => {
                let value = i32::from_le_bytes(self.source.take("an integer")?);
                self.push(Node::Int(value.into()))?;
            }
            0x8a => {
                let len = self.u8("an integer's length")?;
                self.long(len.into())?;
            }
            0x8b => {
                let len = self.u32("an integer's length")?;
                self.long(len)?;
            }
            b'I' | b'L' | b'F' => self.number_line(opcode)?,
            b'G' => {
                let value = f64::from_be_bytes(self.source.take("a number")?);
                self.push(Node::Float(value))?;
            }
            // Text and bytes. Python 2 strings are Latin-1, so are bytes.
            b'U' | b'C' => {
                let len = self.u8("a length")?;
                self.push_string(len.into(), false)?;
            }
            b'T' | b'B' => {
                let len = self.u32("a length")?;
                self.push_string(len.into(), false)?;
            }
            0x8e | 0x96 => {
                let len = self.u64("a length")?;
                self.push_string(len, false)?;
            }
            0x8c => {
                let len = self.u8("a length")?;
                self.push_string(len.into(), true)?;
            }
            b'X' => {
                let len = self.u32("a length")?;
                self.push_string(len.into(), true)?;
            }
            0x8d => {
                let len = self.u64("a length")?;
                self.push_string(len, true)?;
            }
            b'S' | b'V' => self.string_line(opcode)?,
            // A buffer inside the file may be read-only or not.
            0x98 => {}
            // Tuples, lists, sets, dicts.
            b')' => self.push(Node::Tuple(Vec::new()))?,
            b't' => {
                let items = self.pop_to_mark()?;
                self.push(Node::Tuple(items))?;
            }
            0x85..=0x87 => {
                let mut items = Vec::new();
                for _ in 0x85..=opcode {
                    items.push(self.pop("an item of a tuple")?);
                }
                items.reverse();
                self.push(Node::Tuple(items))?;
            }
            b']' | 0x8f => self.push(Node::List(Vec::new()))?,
            b'l' | 0x91 => {
                let items = self.pop_to_mark()?;
                self.push(Node::List(items))?;
            }
            b'a' => {
                let item = self.pop("an item of a list")?;
                self.extend_list(&[item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_to_mark()?;
                self.extend_list(&items)?;
            }
            b'}' => self.push(Node::Dict(Vec::new()))?,
            b'd' => {
                let items = self.pop_to_mark()?;
                self.push(Node::Dict(Vec::new()))?;
                self.extend_dict(&items)?;
            }
            b's' => {
                let value = self.pop("a value of a dict")?;
                let key = self.pop("a key of a dict")?;
                self.extend_dict(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_to_mark()?;
                self.extend_dict(&items)?;
            }
            // Names, calls, states.
            b'c' => {
                let module = self.text_line("a module")?;
                let name = self.text_line("a name")?;
                self.push_class(&module, &name)?;
            }
            0x93 => {
                let name = self.pop_text("a name")?;
                let module = self.pop_text("a module")?;
                self.push_class(&module, &name)?;
            }
            b'i' => {
                let module = self.text_line("a module")?;
                let name = self.text_line("a name")?;
                let found = format!("an old-style instance of {module}.{name}");
                return self.source.fault("arrays, dicts, lists and numbers", found);
            }
            b'R' => self.call()?,
            0x81 => self.new_object()?,
            b'b' => self.set_state()?,
            other => {
                let found = format!("instruction {other:#04x}{}", refused(other));
                return self
                    .source
                    .fault("an instruction that describes data", found);
            }
        }
        Ok(true)
    }

    fn u8(&mut self, what: &str) -> Result<u8, Fault> {
        let [byte] = self.source.take(what)?;
        Ok(byte)
    }

    fn u32(&mut self, what: &str) -> Result<u32, Fault> {
        Ok(u32::from_le_bytes(self.source.take(what)?))
    }

    fn u64(&mut self, what: &str) -> Result<u64, Fault> {
        Ok(u64::from_le_bytes(self.source.take(what)?))
    }

    /// An integer of `len` bytes, two's complement.
    fn long(&mut self, len: u32) -> Result<(), Fault> {
        let mut value = 0i64;
        if len > 8 {
            let found = format!("one of {len} bytes");
            return self.source.fault("an integer of at most 64 bits", found);
        }
        for place in 0..len {
            let byte = self.u8("an integer")?;
            value |= i64::from(byte) << (8 * place);
        }
        if len > 0 {
            let unused = 64 - 8 * len;
            value = value << unused >> unused;
        }
        self.push(Node::Int(value))
    }

    fn text_line(&mut self, what: &str) -> Result<String, Fault> {
        let line = self.source.line(what)?;
        Ok(String::from_utf8_lossy(&line)
            .trim_end_matches('\r')
            .to_owned())
    }

    fn line_number(&mut self) -> Result<u32, Fault> {
        let line = self.text_line("a memo number")?;
        match line.parse() {
            Ok(key) => Ok(key),
            Err(_) => self.source.fault("a memo number", format!("{line:?}")),
        }
    }

    fn number_line(&mut self, opcode: u8) -> Result<(), Fault> {
        let line = self.text_line("a number")?;
        let node = match (opcode, line.as_str()) {
            (b'I', "00") => Some(Node::Bool(false)),
            (b'I', "01") => Some(Node::Bool(true)),
            (b'F', text) => text.parse().ok().map(Node::Float),
            (_, text) => text.trim_end_matches('L').parse().ok().map(Node::Int),
        };
        match node {
            Some(node) => self.push(node),
            None => {
                let found: String = line.chars().take(40).collect();
                self.source
                    .fault("a number of at most 64 bits", format!("{found:?}"))
            }
        }
    }

    /// Protocol 0: a quoted Python 2 string, or text with `\uXXXX` for what is not Latin-1.
    fn string_line(&mut self, opcode: u8) -> Result<(), Fault> {
        let line = self.source.line("a string")?;
        let bytes = match (opcode, line.as_slice()) {
            (b'S', [b'\'', inner @ .., b'\''] | [b'"', inner @ .., b'"']) => unquoted(inner),
            (b'V', line) => plain_text(line),
            _ => None,
        };
        match bytes {
            Some(bytes) => self.push_spelled(bytes, opcode == b'V'),
            None => self.source.fault("a quoted string", "another spelling"),
        }
    }
}

/// The bytes of a Python 2 string between its quotes.
fn unquoted(line: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(line.len());
    let mut rest = line.iter().copied();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'\\' => match rest.next()? {
                b'n' => b'\n',
                b't' => b'\t',
                b'r' => b'\r',
                b'x' => hex(&mut rest, 2)?.try_into().ok()?,
                same @ (b'\\' | b'\'' | b'"') => same,
                _ => return None,
            },
            byte => byte,
        });
    }
    Some(bytes)
}

/// Latin-1 text with escapes (Python's raw-unicode-escape) as UTF-8.
fn plain_text(line: &[u8]) -> Option<Vec<u8>> {
    let mut text = String::with_capacity(line.len());
    let mut rest = line.iter().copied().peekable();
    while let Some(byte) = rest.next() {
        let digits = match (byte, rest.peek()) {
            (b'\\', Some(b'u')) => 4,
            (b'\\', Some(b'U')) => 8,
            _ => {
                text.push(char::from(byte));
                continue;
            }
        };
        rest.next();
        text.push(char::from_u32(hex(&mut rest, digits)?)?);
    }
    Some(text.into_bytes())
}

fn hex(rest: &mut impl Iterator<Item = u8>, digits: usize) -> Option<u32> {
    (0..digits).try_fold(0, |value, _| {
        Some(value << 4 | char::from(rest.next()?).to_digit(16)?)
    })
}

/// What a refused instruction would do.
fn refused(opcode: u8) -> &'static str {
    match opcode {
        b'P' | b'Q' => ", a persistent id, which only the program that wrote it can resolve",
        0x82..=0x84 => ", an extension code, which only the program that wrote it can resolve",
        0x97 => ", a buffer outside the file (pickle without buffer_callback)",
        b'o' => ", an old-style instance",
        0x92 => ", an instance made with named arguments",
        _ => ", which no pickle has",
    }
}
