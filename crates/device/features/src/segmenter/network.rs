//! A network read from a TFLite file: the operators that MediaPipe's selfie segmentation uses, in 32-bit floats.
//!
//! All other operators, types and options are refused. Shapes are computed from the input and the kernels; what the file
//! declares is compared with them. Sources: TensorFlow Lite's schema.fbs (version 3), and for `Convolution2DTransposeBias`
//! MediaPipe's `transpose_conv_bias.cc`.

use std::collections::HashMap;

use super::flatbuffer::{Damaged, Table};
use super::operators::{Operator, Shape, Window, numbers};

/// Largest numbers of tensors, of operators, of weights, of all numbers between operators, and of multiplications. The real
/// file has 360, 246, and 0.1, 7 and 58 million.
const MOST_PARTS: usize = 4096;
const MOST_WEIGHTS: usize = 1 << 24;
const MOST_VALUES: usize = 1 << 27;
const MOST_PRODUCTS: usize = 1 << 31;
const TOO_LARGE: &str = "it is larger than a network that finds people needs to be";

/// A network with one image as input, red, green and blue from 0 to 1, and one number per pixel of it as output.
pub(super) struct Network {
    /// Height, width and 3.
    pub(super) input: Shape,
    steps: Vec<Step>,
    /// The number of tensors of the file.
    tensors: usize,
    first: usize,
    last: usize,
}

struct Step {
    operator: Operator,
    input: usize,
    /// The second input of a sum or product; otherwise the first again.
    other: usize,
    output: usize,
    from: Shape,
    to: Shape,
    /// Tensors that no later step reads.
    done: Vec<usize>,
}

impl Network {
    /// Reads a file; the error says what is wrong with it.
    pub(super) fn read(file: &[u8]) -> Result<Self, String> {
        if file.get(4..8) != Some(b"TFL3") {
            return Err("it is not a TFLite file".to_owned());
        }
        let model = Table::root(file)?;
        let [graph] = model.tables(2, MOST_PARTS)?[..] else {
            return Err("it has more than one graph".to_owned());
        };
        let (inputs, outputs) = (graph.ints(1)?, graph.ints(2)?);
        let ([first], [last]) = (&inputs[..], &outputs[..]) else {
            return Err("it has more than one input or output".to_owned());
        };
        let mut reader = Reader {
            tensors: graph.tables(0, MOST_PARTS)?,
            buffers: model.tables(4, MOST_PARTS)?,
            codes: model.tables(1, MOST_PARTS)?,
            halves: HashMap::new(),
            shapes: HashMap::new(),
            weights: 0,
            values: 0,
            products: 0,
        };
        let (first, last) = (index(*first)?, index(*last)?);
        let input = reader.declared(first)?;
        if input[2] != 3 || input[..2].iter().any(|side| !(32..=1024).contains(side) || side % 4 != 0) {
            return Err("its input is not one colour image of 32 to 1024 pixels".to_owned());
        }
        reader.shapes.insert(first, input);
        let mut steps = Vec::new();
        for operator in graph.tables(3, MOST_PARTS)? {
            steps.extend(reader.step(operator)?);
        }
        if reader.shapes.get(&last) != Some(&[input[0], input[1], 1]) {
            return Err("its output is not one number for each pixel of its input".to_owned());
        }
        let tensors = reader.tensors.len();
        let mut read_later = vec![false; tensors];
        read_later[last] = true;
        for step in steps.iter_mut().rev() {
            for tensor in [step.input, step.other] {
                if !std::mem::replace(&mut read_later[tensor], true) {
                    step.done.push(tensor);
                }
            }
        }
        Ok(Self { input, steps, tensors, first, last })
    }

    /// The output `[height, width]` for an image `[height, width, 3]` of the input's size.
    pub(super) fn run(&self, image: Vec<f32>) -> Vec<f32> {
        let mut values = vec![Vec::new(); self.tensors];
        values[self.first] = image;
        for step in &self.steps {
            values[step.output] =
                step.operator.apply(&values[step.input], &values[step.other], step.from, step.to);
            step.done.iter().for_each(|tensor| values[*tensor] = Vec::new());
        }
        std::mem::take(&mut values[self.last])
    }
}

struct Reader<'a> {
    tensors: Vec<Table<'a>>,
    buffers: Vec<Table<'a>>,
    codes: Vec<Table<'a>>,
    /// Tensors that are 16-bit weights as floats, with the tensor that has the weights.
    halves: HashMap<usize, usize>,
    /// Shapes of the input and of all results so far.
    shapes: HashMap<usize, Shape>,
    /// Weights, numbers of results and multiplications so far.
    weights: usize,
    values: usize,
    products: usize,
}

impl Reader<'_> {
    /// One operator; `None` for the one that turns 16-bit weights into floats.
    fn step(&mut self, operator: Table<'_>) -> Result<Option<Step>, String> {
        let code = self.codes.get(index(operator.int(0, 0)?)?).ok_or(Damaged)?;
        // Files of old writers have the number in the first field only.
        let number = code.int(3, 0)?.max(i32::from(code.byte(0, 0)?));
        let custom = code.bytes(1)?;
        let places =
            |field| operator.ints(field)?.into_iter().map(index).collect::<Result<Vec<_>, Damaged>>();
        let (inputs, outputs) = (places(1)?, places(2)?);
        let (Some(&input), [output]) = (inputs.first(), &outputs[..]) else { return Err(Damaged.into()) };
        let input_at = |at: usize| inputs.get(at).copied().ok_or(Damaged);
        if number == 6 {
            self.halves.insert(*output, input);
            return Ok(None);
        }
        let from = *self.shapes.get(&input).ok_or("an operator comes before its input")?;
        // Options that are omitted as a whole have their defaults: those of a table without fields.
        let options = operator.table(4)?;
        let int = |field, default| options.map_or(Ok(default), |options| options.int(field, default));
        let byte = |field| options.map_or(Ok(0), |options| options.byte(field, 0));
        let unfused = |field| match byte(field)? {
            0 => Ok(()),
            _ => Err("it has fused activations, which are not supported".to_owned()),
        };
        let (mut other, mut products) = (input, numbers(from));
        let (operator, to) = match (number, custom) {
            (0 | 18, _) => {
                unfused(0)?;
                other = input_at(1)?;
                let second = *self.shapes.get(&other).ok_or("an operator comes before its input")?;
                match number {
                    0 if second == from => (Operator::Add, from),
                    18 if second == from || second == [1, 1, from[2]] => (Operator::Multiply, from),
                    _ => return Err("it adds or multiplies images of different shapes".to_owned()),
                }
            }
            (1, _) => {
                unfused(5)?;
                if [index(int(4, 0)?)?, index(int(3, 0)?)?] != from[..2] || byte(0)? != 1 {
                    return Err("it has means over a part of an image, which are not supported".to_owned());
                }
                (Operator::Mean, [1, 1, from[2]])
            }
            (40, _) => {
                let mut axes = self.integers(input_at(1)?)?;
                axes.sort_unstable();
                if axes != [1, 2] || byte(0)? != 1 {
                    return Err("it has means over other sides than rows and columns".to_owned());
                }
                (Operator::Mean, [1, 1, from[2]])
            }
            (3 | 4, _) => {
                let (kernel_at, bias_at) = (input_at(1)?, input_at(2)?);
                let depthwise = number == 4;
                unfused(if depthwise { 4 } else { 3 })?;
                let (multiplier, dilation) = if depthwise { (int(3, 1)?, 5) } else { (1, 4) };
                if multiplier != 1 || int(dilation, 1)? != 1 || int(dilation + 1, 1)? != 1 {
                    return Err("it has dilated convolutions, which are not supported".to_owned());
                }
                let ([outer, rows, columns, inner], kernel) = self.kernel(kernel_at)?;
                let stride = [index(int(2, 0)?)?, index(int(1, 0)?)?];
                let (window, [height, width]) = window(from, [rows, columns], stride, byte(0)?)?;
                let (wanted, channels) =
                    if depthwise { ([1, from[2]], inner) } else { ([outer, from[2]], outer) };
                if [outer, inner] != wanted {
                    return Err("a kernel does not fit its image".to_owned());
                }
                let bias = self.bias(bias_at, channels)?;
                products = height.saturating_mul(width).saturating_mul(kernel.len());
                let operator = if depthwise {
                    Operator::Depthwise { window, kernel, bias }
                } else {
                    // `[outer, rows, columns, inner]` with the output channels last.
                    let cells = rows * columns * inner;
                    let turned = (0..cells).flat_map(|cell| kernel.iter().skip(cell).step_by(cells).copied());
                    Operator::Conv { window, kernel: turned.collect(), bias }
                };
                (operator, [height, width, channels])
            }
            (14, _) => (Operator::Logistic, from),
            (19, _) => (Operator::Relu, from),
            (117, _) => (Operator::HardSwish, from),
            (23, _) => {
                let size = self.integers(input_at(1)?)?;
                let [height, width] = size[..] else { return Err(Damaged.into()) };
                if byte(2)? != 0 || byte(3)? != 1 {
                    return Err("it interpolates without half-pixel centres".to_owned());
                }
                (Operator::Resize, [index(height)?, index(width)?, from[2]])
            }
            (32, b"Convolution2DTransposeBias") => {
                let ([outer, rows, columns, inner], kernel) = self.kernel(input_at(1)?)?;
                // Padding (1 is "same", as none is), and the strides along x and y.
                let stride = [columns, rows].map(|side| (side as u32).to_le_bytes());
                let fits = [[1, 0, 0, 0], stride[0], stride[1]].concat() == operator.bytes(5)?;
                if !fits || inner != from[2] {
                    return Err("it has a transposed convolution whose kernel is not its stride".to_owned());
                }
                let to = [from[0].saturating_mul(rows), from[1].saturating_mul(columns), outer];
                products = (from[0] * from[1]).saturating_mul(kernel.len());
                (
                    Operator::Transposed {
                        size: [rows, columns],
                        bias: self.bias(input_at(2)?, outer)?,
                        kernel,
                    },
                    to,
                )
            }
            _ => {
                let name = String::from_utf8_lossy(&custom[..custom.len().min(40)]).into_owned();
                return Err(format!("its operator {number} {name} is not supported").replace("  ", " "));
            }
        };
        if self.declared(*output)? != to || self.shapes.insert(*output, to).is_some() {
            return Err("a result does not have its declared shape".to_owned());
        }
        self.values += numbers(to);
        self.products = self.products.saturating_add(products);
        if self.values > MOST_VALUES || self.products > MOST_PRODUCTS {
            return Err(TOO_LARGE.to_owned());
        }
        Ok(Some(Step { operator, input, other, output: *output, from, to, done: Vec::new() }))
    }

    fn tensor(&self, at: usize) -> Result<(Vec<usize>, u8, &[u8]), Damaged> {
        let tensor = self.tensors.get(at).ok_or(Damaged)?;
        let sides = tensor.ints(0)?.into_iter().map(index).collect::<Result<_, _>>()?;
        let buffer = self.buffers.get(index(tensor.int(2, 0)?)?).ok_or(Damaged)?;
        Ok((sides, tensor.byte(1, 0)?, buffer.bytes(0)?))
    }

    /// The declared shape of an image of floats.
    fn declared(&self, at: usize) -> Result<Shape, String> {
        let (sides, 0, []) = self.tensor(at)? else {
            return Err("a result is not of 32-bit floats".to_owned());
        };
        let [1, height, width, channels] = sides[..] else {
            return Err("a result is not one image".to_owned());
        };
        let shape = [height, width, channels];
        match shape.iter().fold(1, |all: usize, side| all.saturating_mul(*side)) {
            1..=MOST_VALUES => Ok(shape),
            _ => Err(TOO_LARGE.to_owned()),
        }
    }

    fn integers(&self, at: usize) -> Result<Vec<i32>, Damaged> {
        let (_, kind, bytes) = self.tensor(at)?;
        let four = |four: &[u8]| four.first_chunk().copied().map(i32::from_le_bytes);
        if kind == 2 {
            bytes.chunks_exact(4).map(four).collect::<Option<_>>().ok_or(Damaged)
        } else {
            Err(Damaged)
        }
    }

    /// The sides and numbers of weights, 16-bit ones included.
    fn weights(&mut self, at: usize) -> Result<(Vec<usize>, Vec<f32>), String> {
        let at = self.halves.get(&at).copied().unwrap_or(at);
        let (sides, kind, bytes) = self.tensor(at)?;
        let values: Vec<f32> = match kind {
            0 => bytes
                .chunks_exact(4)
                .filter_map(|four| Some(f32::from_le_bytes(*four.first_chunk()?)))
                .collect(),
            1 => bytes
                .chunks_exact(2)
                .filter_map(|two| Some(half(u16::from_le_bytes(*two.first_chunk()?))))
                .collect(),
            _ => return Err("its weights are neither 16-bit nor 32-bit floats".to_owned()),
        };
        let expected = sides.iter().try_fold(1_usize, |all, side| all.checked_mul(*side)).ok_or(Damaged)?;
        if values.len() != expected || !values.iter().all(|value| value.is_finite()) {
            return Err(Damaged.into());
        }
        self.weights += expected;
        if self.weights > MOST_WEIGHTS {
            return Err(TOO_LARGE.to_owned());
        }
        Ok((sides, values))
    }

    fn kernel(&mut self, at: usize) -> Result<([usize; 4], Vec<f32>), String> {
        let (sides, values) = self.weights(at)?;
        match <[usize; 4]>::try_from(sides) {
            Ok(sides) if !values.is_empty() => Ok((sides, values)),
            _ => Err("a kernel does not have four sides".to_owned()),
        }
    }

    fn bias(&mut self, at: usize, channels: usize) -> Result<Vec<f32>, String> {
        match self.weights(at)? {
            (sides, values) if sides == [channels] => Ok(values),
            _ => Err("a bias does not fit its kernel".to_owned()),
        }
    }
}

/// A position or size, which is not negative.
fn index(number: i32) -> Result<usize, Damaged> {
    usize::try_from(number).map_err(|_| Damaged)
}

/// The window of a convolution, and height and width of its result. `padding`: 0 is "same", 1 "valid".
fn window(
    from: Shape,
    size: [usize; 2],
    stride: [usize; 2],
    padding: u8,
) -> Result<(Window, [usize; 2]), String> {
    let (mut before, mut to) = ([0; 2], [0; 2]);
    for axis in 0..2 {
        let (image, size, stride) = (from[axis], size[axis], stride[axis]);
        if !(1..=64).contains(&stride) || size > 64 || padding > 1 || (padding == 1 && size > image) {
            return Err("a convolution has an impossible size, stride or padding".to_owned());
        }
        to[axis] = if padding == 0 { image.div_ceil(stride) } else { (image - size) / stride + 1 };
        before[axis] =
            if padding == 0 { ((to[axis] - 1) * stride + size).saturating_sub(image) / 2 } else { 0 };
    }
    Ok((Window { size, stride, before }, to))
}

/// A 16-bit float (IEEE 754 binary16).
fn half(bits: u16) -> f32 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f32::from(bits & 0x3ff) / 1024.0);
    let size = match exponent {
        0 => fraction * 2f32.powi(-14),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1.0 + fraction) * 2f32.powi(exponent - 15),
    };
    if bits >> 15 == 0 { size } else { -size }
}
