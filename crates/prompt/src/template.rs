//! A template's file as a struct.

use std::path::Path;
use std::sync::LazyLock;

use domain::names::nearest;
use serde::Deserialize;
use toml::{Table, Value};

/// Longest name of a template in bytes: there is little room for facts.
const MAX_VERSION: usize = 40;

/// The texts of a prompt, checked.
#[derive(Debug)]
pub struct Template {
    texts: Texts,
    file: String,
    hash: String,
}

/// A file that is not a template.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct TemplateError(String);

impl Template {
    /// The file of the built-in template.
    pub const BUILT_IN_FILE: &str = include_str!("../v2.toml");

    /// The built-in template.
    pub fn built_in() -> &'static Self {
        static TEMPLATE: LazyLock<Template> = LazyLock::new(|| {
            let texts = toml::from_str(Template::BUILT_IN_FILE);
            // The file is compiled in, and a test parses it.
            Template::new(texts.expect("the template parses"), Template::BUILT_IN_FILE)
        });
        &TEMPLATE
    }

    fn new(texts: Texts, file: &str) -> Self {
        let hash = blake3::hash(file.as_bytes()).to_hex().to_string();
        Self { texts, file: file.to_owned(), hash }
    }

    /// Reads a user's template from the file `path`.
    ///
    /// # Errors
    /// When it cannot be read, and those of [`Template::parse`].
    pub fn read(path: &Path) -> Result<Self, TemplateError> {
        let of_file = |problem| TemplateError(format!("the prompt {}: {problem}", path.display()));
        let text = durable::input::read_text(path).map_err(|error| of_file(error.to_string()))?;
        Self::parse(&text).map_err(|TemplateError(problem)| of_file(problem))
    }

    /// The template in `file`, which has the keys of the built-in one.
    ///
    /// # Errors
    /// Names the first key that is missing, unknown or not a text, that has an unknown name in braces, or the line that is not
    /// TOML; the version, if it is too long, or that of the built-in template in a file that differs from it.
    pub fn parse(file: &str) -> Result<Self, TemplateError> {
        let table = |file: &str| {
            file.parse::<Table>().map_err(|error| {
                let line = error.span().map_or(0, |span| file[..span.start].matches('\n').count());
                let message = error.message().replace('\n', ", ");
                TemplateError(format!("line {} is not TOML: {message}", line + 1))
            })
        };
        let (given, built_in) = (table(file)?, table(Self::BUILT_IN_FILE)?);
        let names = names_in_braces(Self::BUILT_IN_FILE);
        check(&given, &built_in, &names, "")?;
        let texts: Texts = given
            .try_into()
            .map_err(|error: toml::de::Error| TemplateError(error.message().replace('\n', ", ")))?;
        let version = &texts.version;
        if version.is_empty() || version.len() > MAX_VERSION {
            let problem = format!("version: a name of 1 to {MAX_VERSION} bytes is needed");
            return Err(TemplateError(problem));
        }
        if file != Self::BUILT_IN_FILE && *version == Self::built_in().texts.version {
            let problem = format!(
                "version: {version} is the built-in template, from which this one differs: give it a name of its own"
            );
            return Err(TemplateError(problem));
        }
        Ok(Self::new(texts, file))
    }

    /// Its name, for example `prompt/2`.
    pub fn version(&self) -> &str {
        &self.texts.version
    }

    /// The text of its file.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// The BLAKE3 hash of its file in hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    pub(super) fn texts(&self) -> &Texts {
        &self.texts
    }
}

/// Checks that `given`, the table `of` a file, has the keys of `built_in`, each a text with known `names` in braces.
fn check(given: &Table, built_in: &Table, names: &[&str], of: &str) -> Result<(), TemplateError> {
    let path = |key: &str| if of.is_empty() { key.to_owned() } else { format!("{of}.{key}") };
    if let Some(key) = given.keys().find(|key| !built_in.contains_key(*key)) {
        let known: Vec<String> = built_in.keys().map(|key| path(key)).collect();
        let like = nearest(&path(key), &known).map(|like| format!(": did you mean `{like}`?"));
        let problem = format!("unknown key `{}`{}", path(key), like.unwrap_or_default());
        return Err(TemplateError(problem));
    }
    for (key, expected) in built_in {
        let key_path = path(key);
        match (given.get(key), expected) {
            (None, _) => return Err(TemplateError(format!("the key `{key_path}` is missing"))),
            (Some(Value::Table(given)), Value::Table(expected)) => {
                check(given, expected, names, &key_path)?;
            }
            (Some(Value::String(text)), Value::String(_)) => {
                if let Some(name) = names_in_braces(text).iter().find(|name| !names.contains(name))
                {
                    let like =
                        nearest(name, names).map(|like| format!(": did you mean {{{like}}}?"));
                    let problem =
                        format!("{key_path}: unknown name {{{name}}}{}", like.unwrap_or_default());
                    return Err(TemplateError(problem));
                }
            }
            (Some(_), Value::Table(_)) => {
                return Err(TemplateError(format!("`{key_path}` is not a table")));
            }
            (Some(_), _) => return Err(TemplateError(format!("`{key_path}` is not a text"))),
        }
    }
    Ok(())
}

/// The names in braces, `{like_this}`, in a text.
fn names_in_braces(text: &str) -> Vec<&str> {
    let inside = text.split('{').skip(1).filter_map(|rest| Some(rest.split_once('}')?.0));
    let is_name = |name: &&str| {
        !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_')
    };
    let mut names: Vec<&str> = inside.filter(is_name).collect();
    names.sort_unstable();
    names.dedup();
    names
}

/// Defines structs of texts, which have to be in the file and are the only ones there.
macro_rules! texts {
    ($($name:ident { $($field:ident),* $(,)? })*) => {
        $(
            #[derive(Debug, Deserialize)]
            #[serde(deny_unknown_fields)]
            pub(super) struct $name {
                $(pub(super) $field: String,)*
            }
        )*
    };
}

/// The template's texts. `v2.toml` says what each is for.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Texts {
    pub(super) version: String,
    pub(super) system: String,
    pub(super) memory: MemoryTexts,
    pub(super) task: TaskTexts,
    pub(super) window: WindowTexts,
    pub(super) now: NowTexts,
    pub(super) view: ViewTexts,
    pub(super) words: WorldWords,
}

/// The words for what agents do, by world.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorldWords {
    warehouse: Words,
    other: Words,
}

impl WorldWords {
    /// The names in texts, and the words for them in the world of this name.
    pub(super) fn of(&self, world: &str) -> [(&'static str, &str); 4] {
        let Words { walk, walked, place, changed } =
            if world == "warehouse" { &self.warehouse } else { &self.other };
        [("walk", walk), ("walked", walked), ("place", place), ("changed", changed)]
    }
}

texts! {
    MemoryTexts {
        begin, nothing, end, elsewhere, document, summary, semantic, note, captioned_begin, caption,
        captioned_end, demonstration_begin, demonstration_view, demonstration_actions, then, several,
        demonstration_end, part_begin, part_end, hint, retrieved_begin, one_retrieved_begin,
        cosine_distance, other_distance, retrieved_action, retrieved_view, retrieved_view_alone,
        retrieved_end, plan_begin, plan_part, plan_own, plan_end,
    }
    TaskTexts { text }
    WindowTexts { begin, nothing, view, step, no_action, end }
    NowTexts { begin, end }
    ViewTexts { label, not_shown, after, current, current_not_shown }
    Words { walk, walked, place, changed }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_template_of_ones_own_has_a_name_and_a_hash_of_its_own() {
        let built_in = Template::built_in();
        assert_eq!(built_in.version(), "prompt/2");
        assert_eq!(Template::parse(Template::BUILT_IN_FILE).unwrap().hash(), built_in.hash());
        let own = Template::BUILT_IN_FILE.replace("\"prompt/2\"", "\"mine/1\"");
        let own = Template::parse(&own).unwrap();
        assert_eq!(own.version(), "mine/1");
        assert_ne!(own.hash(), built_in.hash());
    }

    #[test]
    fn what_is_wrong_with_a_template_is_said_in_one_sentence_with_the_key() {
        let problem = |from: &str, to: &str| {
            let file = Template::BUILT_IN_FILE.replacen("\"prompt/2\"", "\"mine/1\"", 1);
            assert!(file.contains(from), "{from}");
            let problem = Template::parse(&file.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(!problem.contains('\n'), "{problem}");
            problem
        };
        for (from, to, expected) in [
            ("no_action = \"none\"\n", "", "the key `window.no_action` is missing"),
            (
                "[view]\n",
                "[view]\nlabl = \"\"\n",
                "unknown key `view.labl`: did you mean `view.label`?",
            ),
            ("[words.other]\n", "[words.moon]\n", "unknown key `words.moon`"),
            ("then = \", \"", "then = 1", "`memory.then` is not a text"),
            (
                "<task>\\n{instruction}",
                "<task>\\n{instructoin}",
                "task.text: unknown name {instructoin}: did you mean {instruction}?",
            ),
            ("[task]\n", "task]\n", "line "),
            ("\"mine/1\"", "\"\"", "version: a name of 1 to 40 bytes is needed"),
            ("\"mine/1\"", &format!("{:?}", "x".repeat(41)), "version: a name of 1 to 40 bytes"),
            ("\"mine/1\"\n", "\"prompt/2\" \n", "version: prompt/2 is the built-in template"),
        ] {
            let problem = problem(from, to);
            assert!(problem.starts_with(expected), "{problem}");
        }
        let path = Path::new("/nowhere/mine.toml");
        let unread = Template::read(path).unwrap_err().to_string();
        assert!(unread.starts_with("the prompt /nowhere/mine.toml: "), "{unread}");
    }

    #[test]
    fn braces_of_an_example_in_json_stand_for_themselves() {
        let file = Template::BUILT_IN_FILE
            .replace("\"prompt/2\"", "\"mine/1\"")
            .replace("no_action = \"none\"", "no_action = '{\"action\": null} {}'");
        assert!(Template::parse(&file).is_ok());
    }
}
