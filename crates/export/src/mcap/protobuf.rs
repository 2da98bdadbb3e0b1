//! Writing Protocol Buffers (<https://protobuf.dev/programming-guides/encoding/>).

/// A message under construction. Fields with the value 0 may be left out.
#[derive(Debug, Default)]
pub(super) struct ProtobufMessage {
    bytes: Vec<u8>,
}

impl ProtobufMessage {
    /// The message that `write` writes.
    pub(super) fn of(write: impl FnOnce(&mut Self)) -> Vec<u8> {
        let mut message = Self::default();
        write(&mut message);
        message.bytes
    }

    fn key(&mut self, field: u32, wire_type: u32) {
        self.varint(u64::from(field << 3 | wire_type));
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// An integer that is not negative, or an enum.
    pub(super) fn whole(&mut self, field: u32, value: u64) {
        self.key(field, 0);
        self.varint(value);
    }

    pub(super) fn double(&mut self, field: u32, value: f64) {
        self.key(field, 1);
        self.bytes.extend(value.to_le_bytes());
    }

    pub(super) fn data(&mut self, field: u32, value: &[u8]) {
        self.key(field, 2);
        self.varint(value.len() as u64);
        self.bytes.extend(value);
    }

    pub(super) fn text(&mut self, field: u32, value: &str) {
        self.data(field, value.as_bytes());
    }

    pub(super) fn nested(&mut self, field: u32, write: impl FnOnce(&mut Self)) {
        self.data(field, &Self::of(write));
    }
}
