//! The parts of an input.

use bytemuck::Pod;

/// Numbers and messages from the front of an input. Beyond its end there are zeros.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Input<'a>(pub(crate) &'a [u8]);

impl<'a> Input<'a> {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        first
    }

    pub(crate) fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// So many bytes, or what is left.
    pub(crate) fn bytes(&mut self, len: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(len.min(self.0.len()));
        self.0 = rest;
        taken
    }

    /// `message` with up to 15 of its bytes replaced: so most of it stays valid, and the rest of a reader is reached.
    pub(crate) fn changed<M: Pod>(&mut self, mut message: M) -> M {
        for _ in 0..self.byte() % 16 {
            let (at, value) = (usize::from(self.word()), self.byte());
            bytemuck::bytes_of_mut(&mut message)[at % size_of::<M>()] = value;
        }
        message
    }
}

/// The files in a text: each begins with a line `=== NAME`. Text before the first has no name.
pub(crate) fn files(input: &[u8]) -> Vec<(&str, &[u8])> {
    const MARK: &[u8] = b"=== ";
    let mut found: Vec<(&str, usize, usize)> = Vec::new();
    let mut at = 0;
    for line in input.split_inclusive(|&byte| byte == b'\n') {
        if let Some(name) = line.strip_prefix(MARK)
            && let Ok(name) = str::from_utf8(name)
        {
            if let Some((_, _, end)) = found.last_mut() {
                *end = at;
            }
            found.push((name.trim_end_matches('\n'), at + line.len(), input.len()));
        }
        at += line.len();
    }
    found.into_iter().map(|(name, start, end)| (name, &input[start..end])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_is_split_at_its_file_names() {
        let input = b"ignored\n=== a.json\n{}\n=== b\nx\ny";
        assert_eq!(files(input), [("a.json", &b"{}\n"[..]), ("b", b"x\ny")]);
        assert!(files(b"none").is_empty());
    }

    #[test]
    fn a_message_is_changed_where_the_input_says() {
        let mut input = Input(&[2, 1, 0, 7, 5, 0, 9]);
        assert_eq!(input.changed([0_u8; 4]), [0, 9, 0, 0]);
        assert!(input.is_empty());
    }
}
