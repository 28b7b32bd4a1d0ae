//! The operators of a network, on one image `[height, width, channels]` of floats.
//!
//! Sums run in the order of the memory and on one thread, so equal inputs give equal outputs.

/// Height, width and channels.
pub(super) type Shape = [usize; 3];

/// Numbers of an image or of a kernel.
pub(super) fn numbers(shape: Shape) -> usize {
    shape.iter().product()
}

/// Size and steps of a window, and how far it begins before the image. The same along both axes where one number stands.
#[derive(Clone, Copy)]
pub(super) struct Window {
    /// Height and width.
    pub(super) size: [usize; 2],
    pub(super) stride: [usize; 2],
    /// Rows above and columns left of the image.
    pub(super) before: [usize; 2],
}

pub(super) enum Operator {
    /// Kernel `[rows, columns, input channels, output channels]`, and a bias for each output channel.
    Conv {
        window: Window,
        kernel: Vec<f32>,
        bias: Vec<f32>,
    },
    /// Kernel `[rows, columns, channels]`, and a bias for each channel.
    Depthwise {
        window: Window,
        kernel: Vec<f32>,
        bias: Vec<f32>,
    },
    /// Transposed convolution whose stride is the size of its kernel `[output channels, rows, columns, input channels]`.
    Transposed {
        size: [usize; 2],
        kernel: Vec<f32>,
        bias: Vec<f32>,
    },
    /// The mean of each channel.
    Mean,
    Add,
    /// By another image, or by one number for each channel.
    Multiply,
    /// Bilinear interpolation; pixels have their centres at halves.
    Resize,
    Relu,
    HardSwish,
    Logistic,
}

impl Operator {
    /// The result; `image` has the shape `from` and the result the shape `to`, which were checked when the file was read.
    pub(super) fn apply(&self, image: &[f32], other: &[f32], from: Shape, to: Shape) -> Vec<f32> {
        let each = |f: fn(f32) -> f32| image.iter().map(|x| f(*x)).collect();
        match self {
            Self::Conv { window, kernel, bias } => {
                convolution(image, from, to, *window, bias, |cell, input, sums| {
                    add_products(input, &kernel[cell * from[2] * to[2]..][..from[2] * to[2]], sums);
                })
            }
            Self::Depthwise { window, kernel, bias } => {
                convolution(image, from, to, *window, bias, |cell, input, sums| {
                    let weights = input.iter().zip(&kernel[cell * to[2]..][..to[2]]);
                    sums.iter_mut().zip(weights).for_each(|(sum, (x, weight))| *sum += x * weight);
                })
            }
            Self::Transposed { size, kernel, bias } => transposed(image, from, to, *size, kernel, bias),
            Self::Mean => {
                let mut sums = vec![0.0; from[2]];
                for pixel in image.chunks_exact(from[2]) {
                    sums.iter_mut().zip(pixel).for_each(|(sum, x)| *sum += x);
                }
                sums.iter().map(|sum| sum / (from[0] * from[1]) as f32).collect()
            }
            Self::Add => image.iter().zip(other).map(|(a, b)| a + b).collect(),
            Self::Multiply => image.iter().zip(other.iter().cycle()).map(|(a, b)| a * b).collect(),
            Self::Resize => resized(image, from, to),
            Self::Relu => each(|x| x.max(0.0)),
            Self::HardSwish => each(|x| x * (x + 3.0).clamp(0.0, 6.0) / 6.0),
            Self::Logistic => each(|x| 1.0 / (1.0 + (-x).exp())),
        }
    }
}

/// Sums over a window around each pixel of the result: `add` gets the number of the cell in the kernel, the pixel of the
/// image under it, and the sums of all channels.
fn convolution(
    image: &[f32],
    from: Shape,
    to: Shape,
    window: Window,
    bias: &[f32],
    add: impl Fn(usize, &[f32], &mut [f32]),
) -> Vec<f32> {
    let mut result = bias.repeat(to[0] * to[1]);
    for (at, sums) in result.chunks_exact_mut(to[2]).enumerate() {
        let corner = [at / to[1] * window.stride[0], at % to[1] * window.stride[1]];
        for row in 0..window.size[0] {
            let y = (corner[0] + row).wrapping_sub(window.before[0]);
            for column in 0..window.size[1] {
                let x = (corner[1] + column).wrapping_sub(window.before[1]);
                if y < from[0] && x < from[1] {
                    add(
                        row * window.size[1] + column,
                        &image[(y * from[1] + x) * from[2]..][..from[2]],
                        sums,
                    );
                }
            }
        }
    }
    result
}

/// Adds the product of a pixel and a kernel `[input channels, output channels]`; sums of 16 outputs stay in registers.
fn add_products(pixel: &[f32], kernel: &[f32], sums: &mut [f32]) {
    let outputs = sums.len();
    let mut at = 0;
    while at < outputs {
        let (kernel, sums) = (&kernel[at..], &mut sums[at..]);
        at += match sums.len() {
            16.. => add_block::<16>(pixel, kernel, outputs, sums),
            8.. => add_block::<8>(pixel, kernel, outputs, sums),
            _ => add_block::<1>(pixel, kernel, outputs, sums),
        };
    }
}

/// The first `N` of these outputs; returns `N`.
fn add_block<const N: usize>(pixel: &[f32], kernel: &[f32], outputs: usize, sums: &mut [f32]) -> usize {
    let mut own = [0.0; N];
    own.copy_from_slice(&sums[..N]);
    for (x, weights) in pixel.iter().zip(kernel.chunks(outputs)) {
        own.iter_mut().zip(&weights[..N]).for_each(|(sum, weight)| *sum += x * weight);
    }
    sums[..N].copy_from_slice(&own);
    N
}

fn transposed(
    image: &[f32],
    from: Shape,
    to: Shape,
    size: [usize; 2],
    kernel: &[f32],
    bias: &[f32],
) -> Vec<f32> {
    let mut result = bias.repeat(to[0] * to[1]);
    for (at, sums) in result.chunks_exact_mut(to[2]).enumerate() {
        let (y, x) = (at / to[1], at % to[1]);
        let pixel = &image[(y / size[0] * from[1] + x / size[1]) * from[2]..][..from[2]];
        for (channel, sum) in sums.iter_mut().enumerate() {
            let cell = (channel * size[0] + y % size[0]) * size[1] + x % size[1];
            let weights = &kernel[cell * from[2]..][..from[2]];
            *sum += pixel.iter().zip(weights).map(|(x, weight)| x * weight).sum::<f32>();
        }
    }
    result
}

fn resized(image: &[f32], from: Shape, to: Shape) -> Vec<f32> {
    // For each new pixel along an axis the two old ones around its centre, and the weight of the second.
    let axis = |old: usize, new: usize| {
        let step = old as f32 / new as f32;
        let at = move |i: usize| ((i as f32 + 0.5) * step - 0.5).clamp(0.0, old as f32 - 1.0);
        (0..new)
            .map(|i| (at(i) as usize, (at(i) as usize + 1).min(old - 1), at(i).fract()))
            .collect::<Vec<_>>()
    };
    let (rows, columns) = (axis(from[0], to[0]), axis(from[1], to[1]));
    let mut result = Vec::with_capacity(numbers(to));
    for (upper, lower, down) in &rows {
        for (left, right, across) in &columns {
            for channel in 0..from[2] {
                let at = |y: &usize, x: &usize| image[(y * from[1] + x) * from[2] + channel];
                let mix = |a: f32, b: f32, share: &f32| a + (b - a) * share;
                let row = |y| mix(at(y, left), at(y, right), across);
                result.push(mix(row(upper), row(lower), down));
            }
        }
    }
    result
}
