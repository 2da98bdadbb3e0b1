//! The manifest of encoders, `assets/models.toml`, read and checked.
//!
//! Model files themselves are opened by [`crate::encoder`].

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use serde::Deserialize;

/// The manifest's file name in an assets folder.
pub const FILE: &str = "models.toml";

const SHIPPED: &str = include_str!("../../assets/models.toml");

/// How a model's tokens become one embedding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pooling {
    /// The first token.
    Cls,
    /// The mean of all tokens after the first.
    Mean,
}

impl Pooling {
    /// The name in the manifest.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Cls => "cls",
            Self::Mean => "mean",
        }
    }
}

/// An encoder's entry in the manifest.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// The name that `--encoder` takes.
    pub name: String,
    /// File name in the cache's `models` folder; `None`: the user provides the file.
    pub file: Option<String>,
    /// SHA-256 of the file, 64 lower-case hexadecimal digits; `None`: not checked.
    pub sha256: Option<String>,
    /// The command that fetches `file`.
    pub brought_by: Option<String>,
    /// Whether the weights are trained.
    pub trained: bool,
    /// Name of the input tensor, (1, 3, `input_size`, `input_size`).
    pub input: String,
    /// Side of the square input, in pixels.
    pub input_size: u32,
    /// Subtracted from each channel's value from 0 to 1.
    pub mean: [f32; 3],
    /// Divides the difference.
    pub std: [f32; 3],
    /// Name of the output tensor, (1, tokens, `dimension`) or (1, `dimension`).
    pub output: String,
    /// How tokens become the embedding.
    pub pooling: Pooling,
    /// Length of the embedding.
    pub dimension: usize,
    /// Where the weights come from.
    pub source: String,
    /// The weights' licence.
    pub licence: String,
}

impl Model {
    /// The displayed name, which marks an untrained model.
    pub fn label(&self) -> String {
        let untrained = !self.trained && !self.name.contains("untrained");
        format!("{}{}", self.name, if untrained { " (untrained)" } else { "" })
    }

    /// The first value that is out of range, if any.
    fn fault(&self) -> Option<String> {
        let is_hex = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
        if self.name.is_empty() || self.input.is_empty() || self.output.is_empty() {
            return Some("`name`, `input` and `output` must not be empty".into());
        }
        if let Some(file) = self.file.as_deref().filter(|f| f.is_empty() || f.contains(['/', '\0']))
        {
            return Some(format!("file = {file:?} must be a file name without a folder"));
        }
        if self.file.is_some() != self.brought_by.is_some() {
            return Some("`file` and `brought_by` go together".into());
        }
        if let Some(sha) = self.sha256.as_ref().filter(|s| s.len() != 64 || !s.bytes().all(is_hex))
        {
            return Some(format!("sha256 = {sha:?} must be 64 lower-case hexadecimal digits"));
        }
        if !(16..=2048).contains(&self.input_size) {
            return Some(format!("input_size = {} must be from 16 to 2048", self.input_size));
        }
        if !(1..=65536).contains(&self.dimension) {
            return Some(format!("dimension = {} must be from 1 to 65536", self.dimension));
        }
        if let Some(mean) = self.mean.iter().find(|m| !m.is_finite()) {
            return Some(format!("mean holds {mean}, which is not finite"));
        }
        if let Some(std) = self.std.iter().find(|s| !s.is_finite() || **s <= 0.0) {
            return Some(format!("std holds {std}; each must be above 0"));
        }
        None
    }
}

/// All encoders.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderManifest {
    /// The name of the default encoder.
    pub default: String,
    /// Their entries.
    #[serde(rename = "model", default)]
    pub models: Vec<Model>,
}

impl EncoderManifest {
    /// The built-in manifest.
    ///
    /// # Errors
    /// Never: a test parses the built-in manifest.
    pub fn shipped() -> Result<Self> {
        Self::parse(SHIPPED, Path::new("assets/models.toml"))
    }

    /// The manifest in the folder `assets`, or the shipped one when that folder has none.
    ///
    /// # Errors
    /// When the file exists and cannot be read or used.
    pub fn load(assets: &Path) -> Result<Self> {
        let path = assets.join(FILE);
        match durable::input::read_text(&path) {
            Ok(text) => Self::parse(&text, &path),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Self::shipped(),
            Err(error) => bail!("cannot read the model manifest {}: {error}", path.display()),
        }
    }

    /// Parses a manifest. Errors name `path`.
    ///
    /// # Errors
    /// When the text is not a manifest, or a value is out of range.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let path = path.display();
        let parsed: Self = toml::from_str(text).map_err(|error| {
            anyhow!("cannot use the model manifest {path}: {}", error.to_string().trim_end())
        })?;
        let invalid =
            |model: &str, what: &str| anyhow!("the model manifest {path}, model `{model}`: {what}");
        for (index, model) in parsed.models.iter().enumerate() {
            if let Some(what) = model.fault() {
                return Err(invalid(&model.name, &what));
            }
            if parsed.models[..index].iter().any(|earlier| earlier.name == model.name) {
                return Err(invalid(&model.name, "the name is taken by an earlier model"));
            }
        }
        if parsed.model(&parsed.default).is_err() {
            return Err(invalid(&parsed.default, "`default` names no model of the manifest"));
        }
        Ok(parsed)
    }

    /// The model called `name`.
    ///
    /// # Errors
    /// When there is none.
    pub fn model(&self, name: &str) -> Result<&Model> {
        self.models.iter().find(|model| model.name == name).with_context(|| {
            let known: Vec<_> =
                self.models.iter().map(|model| format!("`{}`", model.name)).collect();
            format!("unknown encoder `{name}`; the model manifest has {}", known.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<EncoderManifest> {
        EncoderManifest::parse(text, Path::new("models.toml"))
    }

    #[test]
    fn the_shipped_manifest_is_sound() {
        let manifest = EncoderManifest::shipped().unwrap();
        let default = manifest.model(&manifest.default).unwrap();
        assert!(default.trained && default.file.is_some() && default.sha256.is_some());
        assert!(manifest.model("vit-b16").unwrap().file.is_none());
        assert!(!manifest.model("vit-b16-untrained").unwrap().trained);
    }

    #[test]
    fn a_folder_without_a_manifest_means_the_shipped_one() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(
            EncoderManifest::load(folder.path()).unwrap(),
            EncoderManifest::shipped().unwrap()
        );
        std::fs::write(folder.path().join(FILE), "nonsense").unwrap();
        let error = EncoderManifest::load(folder.path()).unwrap_err().to_string();
        assert!(error.starts_with("cannot use the model manifest"), "{error}");
    }

    #[test]
    fn every_broken_value_is_named() {
        for (from, to, expected) in [
            ("default = \"dinov2-s14\"", "default = \"resnet\"", "`default` names no model"),
            ("name = \"vit-b16\"\n", "name = \"dinov2-s14\"\n", "taken by an earlier model"),
            ("input_size = 224", "input_size = 0", "input_size = 0 must be from 16"),
            ("dimension = 384", "dimension = 0", "dimension = 0 must be"),
            ("std = [0.229,", "std = [0.0,", "std holds 0; each must be above 0"),
            ("mean = [0.485,", "mean = [nan,", "mean holds NaN"),
            ("pooling = \"cls\"", "pooling = \"max\"", "unknown variant `max`"),
            ("trained = true", "traind = true", "unknown field `traind`"),
            ("file = \"dinov2", "file = \"../dinov2", "without a folder"),
            ("sha256 = \"e", "sha256 = \"E", "64 lower-case hexadecimal digits"),
            ("licence = \"MIT\"\n", "", "missing field `licence`"),
            ("brought_by = \"cargo xtask setup\"\n", "", "`file` and `brought_by` go together"),
        ] {
            assert!(SHIPPED.contains(from), "{from}");
            let error = parse(&SHIPPED.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains("models.toml") && error.contains(expected), "{to}: {error}");
        }
        let error = EncoderManifest::shipped().unwrap().model("vit").unwrap_err().to_string();
        assert!(error.contains("unknown encoder `vit`") && error.contains("`vit-b16`"), "{error}");
    }
}
