//! A text as sentences, clauses and words, whatever it is written in: markdown, `snake_case`, `CamelCase`.

/// A sentence or a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Sentence {
    /// Its clauses, each of words in lower case. The sign `:` is a word of its own, and so is `/`.
    pub(super) clauses: Vec<Vec<String>>,
    /// It ends in a question mark.
    pub(super) asks: bool,
    /// Something ended it: a full stop, a new line. Without, the text ended.
    pub(super) ended: bool,
}

/// The word that stands for a colon or an equals sign.
pub(super) const COLON: &str = ":";

/// The word that stands for a slash or a bar.
pub(super) const SLASH: &str = "/";

/// Words that begin a new clause.
const JOINTS: [&str; 15] = [
    "but",
    "so",
    "therefore",
    "thus",
    "hence",
    "because",
    "since",
    "while",
    "where",
    "until",
    "however",
    "as",
    "for",
    "which",
    "that",
];

/// The sentences of `text`. One without a word is left out.
pub(super) fn sentences(text: &str) -> Vec<Sentence> {
    let mut reader = Reader::default();
    let mut before = ' ';
    for sign in text.chars() {
        reader.sign(sign, before);
        before = sign;
    }
    reader.end_sentence(false, false);
    reader.sentences
}

#[derive(Default)]
struct Reader {
    sentences: Vec<Sentence>,
    clauses: Vec<Vec<String>>,
    clause: Vec<String>,
    word: String,
}

impl Reader {
    fn sign(&mut self, sign: char, before: char) {
        match sign {
            // Signs without width, which some models put between or into words.
            '\u{200b}'..='\u{200d}' | '\u{2060}' | '\u{feff}' | '\u{ad}' => {}
            '\'' | '’' | 'ʼ' => self.word.push('\''),
            '°' | 'º' => {
                self.end_word();
                self.clause.push("degrees".to_owned());
            }
            _ if sign.is_alphanumeric() => {
                // A new word begins in `moveForward` and `90degrees`.
                let breaks = (before.is_lowercase() && sign.is_uppercase())
                    || (before.is_ascii_digit() && sign.is_alphabetic());
                if breaks {
                    self.end_word();
                }
                self.word.extend(sign.to_lowercase());
            }
            '.' | '!' | '。' | '！' | '…' | '\n' | '\r' => self.end_sentence(false, true),
            '?' | '？' => self.end_sentence(true, true),
            ',' | ';' | '(' | ')' | '>' | '→' | '&' | '+' | '–' | '—' | '，' | '；' | '、' =>
            {
                self.end_clause();
            }
            ':' | '：' | '=' => {
                self.end_word();
                self.clause.push(COLON.to_owned());
            }
            '/' | '|' => {
                self.end_word();
                self.clause.push(SLASH.to_owned());
            }
            _ => self.end_word(),
        }
    }

    fn end_word(&mut self) {
        let word = std::mem::take(&mut self.word);
        let word = word.trim_matches('\'');
        if word.is_empty() {
            return;
        }
        if JOINTS.contains(&word) {
            self.end_clause();
        }
        self.clause.push(word.to_owned());
    }

    fn end_clause(&mut self) {
        self.end_word();
        if !self.clause.is_empty() {
            self.clauses.push(std::mem::take(&mut self.clause));
        }
    }

    fn end_sentence(&mut self, asks: bool, ended: bool) {
        self.end_clause();
        let clauses = std::mem::take(&mut self.clauses);
        if !clauses.is_empty() {
            self.sentences.push(Sentence { clauses, asks, ended });
        }
    }
}
