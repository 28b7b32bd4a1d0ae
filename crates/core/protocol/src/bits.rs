//! Bit strings: fields of fixed width one after another, most significant bit first.

/// Appends values of up to 32 bits to a byte string, most significant bit first.
pub(crate) struct BitWriter {
    bytes: Vec<u8>,
    /// Bits not yet in `bytes`, in the low `pending_bits` bits.
    pending: u64,
    pending_bits: u32,
}

impl BitWriter {
    pub(crate) fn with_capacity(bytes: usize) -> Self {
        Self { bytes: Vec::with_capacity(bytes), pending: 0, pending_bits: 0 }
    }

    /// Appends the low `bits` bits of `value`.
    pub(crate) fn write(&mut self, value: u32, bits: u32) {
        let mask = (1_u64 << bits) - 1;
        self.pending = (self.pending << bits) | (u64::from(value) & mask);
        self.pending_bits += bits;
        while self.pending_bits >= 8 {
            self.pending_bits -= 8;
            self.bytes.push((self.pending >> self.pending_bits) as u8);
        }
        self.pending &= (1 << self.pending_bits) - 1;
    }

    /// The bytes; the last byte is filled up with zero bits.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        if self.pending_bits > 0 {
            self.write(0, 8 - self.pending_bits);
        }
        self.bytes
    }
}

/// Reads what [`BitWriter`] wrote; zero bits past the end.
pub(crate) struct BitReader<'a> {
    bytes: std::slice::Iter<'a, u8>,
    pending: u64,
    pending_bits: u32,
}

impl<'a> BitReader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes: bytes.iter(), pending: 0, pending_bits: 0 }
    }

    /// The next `bits` bits, at most 32.
    pub(crate) fn read(&mut self, bits: u32) -> u32 {
        while self.pending_bits < bits {
            let byte = self.bytes.next().copied().unwrap_or(0);
            self.pending = (self.pending << 8) | u64::from(byte);
            self.pending_bits += 8;
        }
        self.pending_bits -= bits;
        let value = self.pending >> self.pending_bits;
        self.pending &= (1 << self.pending_bits) - 1;
        value as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_bit_is_most_significant() {
        let mut writer = BitWriter::with_capacity(2);
        writer.write(1, 1);
        writer.write(0b101, 3);
        writer.write(0xABC, 12);
        assert_eq!(writer.finish(), [0b1101_1010, 0xBC]);
    }

    #[test]
    fn values_round_trip() {
        let values: Vec<(u32, u32)> =
            (1..=32).flat_map(|bits| [(0, bits), (u32::MAX >> (32 - bits), bits), (1, bits)]).collect();
        let mut writer = BitWriter::with_capacity(0);
        for &(value, bits) in &values {
            writer.write(value, bits);
        }
        let bytes = writer.finish();
        let mut reader = BitReader::new(&bytes);
        for (value, bits) in values {
            assert_eq!(reader.read(bits), value);
        }
    }
}
