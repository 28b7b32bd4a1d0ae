//! The few instructions of Python's pickle that describe a dictionary of tensors.
//!
//! A pickle is a program for a small machine with a stack. Whatever could call something is refused, but for the five names
//! that PyTorch writes for tensors, which here build a description and nothing else. Values lie in one list and refer to each
//! other by number, so that no nesting, however deep, and no value that holds itself can exhaust anything; what is built never
//! grows faster than the file.

use std::collections::BTreeMap;

use super::bytes::Bytes;
use crate::learned::WeightsError;

/// Number of a value.
pub(super) type Id = usize;

/// What a pickle holds.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    None,
    Bool(bool),
    Int(i64),
    /// A whole number beyond 64 bits: the mark at the beginning of files of before 2020.
    Long(Vec<u8>),
    Float,
    Text(String),
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// One of the names that are let in.
    Global(Global),
    /// `persistent_load` of a tuple.
    Storage(Id),
    /// `_rebuild_tensor_v2` of a tuple.
    Tensor(Id),
}

/// The names that are let in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Global {
    OrderedDict,
    RebuildTensor,
    RebuildParameter,
    Storage(Kind),
}

/// What a storage is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Half,
    Float,
    Double,
    /// Whole numbers of so many bytes.
    Whole(usize),
}

/// Values, and which of them the pickle is of.
pub(super) struct Pickle {
    values: Vec<Value>,
    pub(super) root: Id,
}

impl Pickle {
    /// Reads one pickle from the beginning of the bytes.
    pub(super) fn read(bytes: &mut Bytes<'_>) -> Result<Self, WeightsError> {
        let mut machine = Machine::default();
        loop {
            if let Some(root) = machine.step(bytes)? {
                return Ok(Self { values: machine.values, root });
            }
        }
    }

    pub(super) fn value(&self, id: Id) -> &Value {
        &self.values[id]
    }
}

#[derive(Default)]
struct Machine {
    values: Vec<Value>,
    stack: Vec<Id>,
    /// Heights of the stack.
    marks: Vec<usize>,
    memo: BTreeMap<u32, Id>,
}

impl Machine {
    /// One instruction; the result with the last.
    fn step(&mut self, bytes: &mut Bytes<'_>) -> Result<Option<Id>, WeightsError> {
        match bytes.u8()? {
            b'\x80' if (2..=4).contains(&bytes.u8()?) => {} // PROTO
            b'.' => return self.pop().map(Some),            // STOP
            b'(' => self.marks.push(self.stack.len()),      // MARK
            b'N' => self.push(Value::None),
            b'\x88' => self.push(Value::Bool(true)),
            b'\x89' => self.push(Value::Bool(false)),
            b'K' => {
                let value = bytes.u8()?.into(); // BININT1
                self.push(Value::Int(value));
            }
            b'M' => {
                let value = bytes.u16()?.into(); // BININT2
                self.push(Value::Int(value));
            }
            b'J' => {
                let value = i32::from_le_bytes(bytes.array()?).into(); // BININT
                self.push(Value::Int(value));
            }
            b'\x8a' => {
                let length = bytes.u8()?.into(); // LONG1
                let value = long(bytes.take(length)?);
                self.push(value);
            }
            b'G' => {
                bytes.array::<8>()?; // BINFLOAT
                self.push(Value::Float);
            }
            b'X' => {
                let length = bytes.u32()? as usize; // BINUNICODE
                self.text(bytes.take(length)?)?;
            }
            b'T' => {
                let length = bytes.u32()? as usize; // BINSTRING, of Python 2
                self.text(bytes.take(length)?)?;
            }
            b'U' => {
                let length = bytes.u8()?.into(); // SHORT_BINSTRING
                self.text(bytes.take(length)?)?;
            }
            b')' => self.push(Value::Tuple(Vec::new())),
            b'\x85' => self.tuple_of(1)?,
            b'\x86' => self.tuple_of(2)?,
            b'\x87' => self.tuple_of(3)?,
            b't' => {
                let items = self.items()?;
                self.push(Value::Tuple(items));
            }
            b']' => self.push(Value::List(Vec::new())),
            b'}' => self.push(Value::Dict(Vec::new())),
            b'a' => {
                let item = self.pop()?; // APPEND
                self.append(vec![item])?;
            }
            b'e' => {
                let items = self.items()?; // APPENDS
                self.append(items)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?); // SETITEM
                self.set(&[key, value])?;
            }
            b'u' => {
                let items = self.items()?; // SETITEMS
                self.set(&items)?;
            }
            b'q' => {
                let at = bytes.u8()?.into(); // BINPUT
                self.remember(at)?;
            }
            b'r' => {
                let at = bytes.u32()?; // LONG_BINPUT
                self.remember(at)?;
            }
            b'h' => {
                let at = bytes.u8()?.into(); // BINGET
                self.recall(at)?;
            }
            b'j' => {
                let at = bytes.u32()?; // LONG_BINGET
                self.recall(at)?;
            }
            b'c' => {
                let (module, name) = (bytes.line()?, bytes.line()?); // GLOBAL
                self.push(Value::Global(global(module, name)?));
            }
            b'R' => self.reduce()?,
            b'b' => self.build()?,
            b'Q' => {
                let id = self.pop()?; // BINPERSID
                self.push(Value::Storage(id));
            }
            other => return Err(WeightsError::NotTensors(format!("instruction {other:#04x} of a pickle"))),
        }
        Ok(None)
    }

    fn push(&mut self, value: Value) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    fn text(&mut self, bytes: &[u8]) -> Result<(), WeightsError> {
        let text = std::str::from_utf8(bytes).map_err(|_| WeightsError::Damaged("a name is no text"))?;
        self.push(Value::Text(text.to_owned()));
        Ok(())
    }

    fn pop(&mut self) -> Result<Id, WeightsError> {
        // What is below a mark belongs to whoever set it.
        let least = self.marks.last().copied().unwrap_or(0);
        let top = if self.stack.len() > least { self.stack.pop() } else { None };
        top.ok_or(WeightsError::Damaged("a pickle takes what is not there"))
    }

    fn top(&self) -> Result<Id, WeightsError> {
        let least = self.marks.last().copied().unwrap_or(0);
        let top = self.stack[least..].last().copied();
        top.ok_or(WeightsError::Damaged("a pickle takes what is not there"))
    }

    fn items(&mut self) -> Result<Vec<Id>, WeightsError> {
        let mark = self.marks.pop().ok_or(WeightsError::Damaged("a pickle takes what is not there"))?;
        Ok(self.stack.split_off(mark))
    }

    fn tuple_of(&mut self, count: usize) -> Result<(), WeightsError> {
        let mut items = Vec::with_capacity(count);
        for _ in 0..count {
            items.push(self.pop()?);
        }
        items.reverse();
        self.push(Value::Tuple(items));
        Ok(())
    }

    fn append(&mut self, new: Vec<Id>) -> Result<(), WeightsError> {
        let top = self.top()?;
        match &mut self.values[top] {
            Value::List(items) => items.extend(new),
            _ => {
                return Err(WeightsError::NotTensors(
                    "something that is appended to what is no list".to_owned(),
                ));
            }
        }
        Ok(())
    }

    fn set(&mut self, new: &[Id]) -> Result<(), WeightsError> {
        let top = self.top()?;
        match &mut self.values[top] {
            Value::Dict(items) if new.len().is_multiple_of(2) => {
                items.extend(new.chunks_exact(2).map(|pair| (pair[0], pair[1])));
            }
            _ => {
                return Err(WeightsError::NotTensors(
                    "something that is set in what is no dictionary".to_owned(),
                ));
            }
        }
        Ok(())
    }

    fn remember(&mut self, at: u32) -> Result<(), WeightsError> {
        let top = self.top()?;
        self.memo.insert(at, top);
        Ok(())
    }

    fn recall(&mut self, at: u32) -> Result<(), WeightsError> {
        let id = self.memo.get(&at).copied();
        self.stack.push(id.ok_or(WeightsError::Damaged("a pickle takes what is not there"))?);
        Ok(())
    }

    /// A call: of a name that is let in, or the file is refused.
    fn reduce(&mut self) -> Result<(), WeightsError> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let refused = |what: &str| WeightsError::NotTensors(format!("a call of {what}"));
        let Value::Global(function) = self.values[function] else { return Err(refused("what is no name")) };
        let Value::Tuple(items) = &self.values[arguments] else {
            return Err(refused("a name without arguments"));
        };
        let made = match (function, &items[..]) {
            (Global::OrderedDict, []) => Value::Dict(Vec::new()),
            (Global::RebuildTensor, [_, _, _, _, ..]) => Value::Tensor(arguments),
            // The tensor itself, whether it is trained, hooks.
            (Global::RebuildParameter, [tensor, ..]) => match self.values[*tensor] {
                Value::Tensor(of) => Value::Tensor(of),
                _ => return Err(refused("a name with arguments of another form")),
            },
            _ => return Err(refused("a name with arguments of another form")),
        };
        self.push(made);
        Ok(())
    }

    /// The state of a dictionary (`_metadata`: versions of layers) is not looked at; nothing else has one.
    fn build(&mut self) -> Result<(), WeightsError> {
        self.pop()?;
        match self.values[self.top()?] {
            Value::Dict(_) => Ok(()),
            _ => Err(WeightsError::NotTensors("an object with a state".to_owned())),
        }
    }
}

fn long(bytes: &[u8]) -> Value {
    // Two's complement, the lowest byte first.
    let negative = bytes.last().is_some_and(|byte| *byte >= 0x80);
    let mut wide = [if negative { 0xff } else { 0 }; 8];
    match wide.get_mut(..bytes.len()) {
        Some(low) => {
            low.copy_from_slice(bytes);
            Value::Int(i64::from_le_bytes(wide))
        }
        None => Value::Long(bytes.to_owned()),
    }
}

fn global(module: &[u8], name: &[u8]) -> Result<Global, WeightsError> {
    Ok(match (module, name) {
        (b"collections", b"OrderedDict") => Global::OrderedDict,
        (b"torch._utils", b"_rebuild_tensor_v2") => Global::RebuildTensor,
        (b"torch._utils", b"_rebuild_parameter") => Global::RebuildParameter,
        (b"torch", b"HalfStorage") => Global::Storage(Kind::Half),
        (b"torch", b"FloatStorage") => Global::Storage(Kind::Float),
        (b"torch", b"DoubleStorage") => Global::Storage(Kind::Double),
        (b"torch", b"LongStorage") => Global::Storage(Kind::Whole(8)),
        (b"torch", b"IntStorage") => Global::Storage(Kind::Whole(4)),
        (b"torch", b"ShortStorage") => Global::Storage(Kind::Whole(2)),
        (b"torch", b"CharStorage" | b"ByteStorage" | b"BoolStorage") => Global::Storage(Kind::Whole(1)),
        _ => {
            let shown = |bytes: &[u8]| String::from_utf8_lossy(&bytes[..bytes.len().min(40)]).into_owned();
            return Err(WeightsError::NotTensors(format!(
                "the name {:?} of {:?}",
                shown(name),
                shown(module)
            )));
        }
    })
}
