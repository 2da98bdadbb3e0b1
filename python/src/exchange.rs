//! A conversation with a model in the format of OpenAI-compatible servers, as the prompt log stores it.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use domain::hex;
use domain::prompt_log::{RecordedExchange, RecordedMessage, RecordedPart};
use peer::PinnedStep;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyString};

use crate::classes::lossy;
use crate::prompt::view_of_png;

const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Reads a `memtransfer.Exchange` about `step`.
pub(crate) fn read(exchange: &Bound<'_, PyAny>, step: &PinnedStep) -> PyResult<RecordedExchange> {
    let messages = exchange.getattr("messages")?.try_iter()?;
    let text = |name: &str| -> PyResult<Option<String>> {
        let text = exchange.getattr(name)?;
        text.cast::<PyString>().ok().map(lossy).transpose()
    };
    Ok(RecordedExchange {
        messages: messages
            .map(|message| read_message(message?.cast::<PyMapping>()?, step))
            .collect::<PyResult<_>>()?,
        reply: text("reply")?,
        unread: text("unread")?,
    })
}

fn read_message(message: &Bound<'_, PyMapping>, step: &PinnedStep) -> PyResult<RecordedMessage> {
    let py = message.py();
    let mut role = String::new();
    let mut parts = Vec::new();
    let others = PyDict::new(py);
    for entry in message.items()?.iter() {
        let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = entry.extract()?;
        if value.is_none() {
            continue;
        }
        match key.extract::<String>().as_deref() {
            Ok("role") => role = value.str()?.to_string(),
            Ok("content") if value.is_instance_of::<PyString>() => {
                parts.push(read_part(&value, step)?);
            }
            Ok("content") if value.cast::<PyMapping>().is_err() && value.try_iter().is_ok() => {
                for part in value.try_iter()? {
                    parts.push(read_part(&part?, step)?);
                }
            }
            _ => others.set_item(key, value)?,
        }
    }
    // Such as a call of a tool.
    if !others.is_empty() {
        parts.push(RecordedPart::Text(json(&others)?));
    }
    Ok(RecordedMessage { role, parts })
}

fn read_part(part: &Bound<'_, PyAny>, step: &PinnedStep) -> PyResult<RecordedPart> {
    if let Ok(text) = part.cast::<PyString>() {
        return Ok(RecordedPart::Text(lossy(text)?));
    }
    if let Ok(part) = part.cast::<PyMapping>() {
        if let Ok(text) = part.get_item("text")
            && let Ok(text) = text.cast::<PyString>()
        {
            return Ok(RecordedPart::Text(lossy(text)?));
        }
        if let Ok(image) = part.get_item("image_url") {
            let image = image.get_item("url").unwrap_or(image);
            if let Ok(url) = image.extract::<String>() {
                return Ok(read_image(part.py(), &url, step));
            }
        }
    }
    Ok(RecordedPart::Text(json(part)?))
}

/// The image behind a URL: a view of `step` by its hash, another PNG by its content, anything else in words.
fn read_image(py: Python<'_>, url: &str, step: &PinnedStep) -> RecordedPart {
    let views = || step.frames().iter().map(|frame| frame.content_hash());
    if let Some(name) = url.strip_prefix("image:")
        && views().any(|hash| hex(&hash) == name)
    {
        return RecordedPart::Image(name.to_owned());
    }
    let Some((kind, data)) = url.strip_prefix("data:").and_then(|data| data.split_once(";base64,"))
    else {
        return RecordedPart::Text(format!("[the image at {url}]"));
    };
    let Ok(content) = STANDARD.decode(data) else {
        return RecordedPart::Text(format!("[an image ({kind}) that is not valid base64]"));
    };
    match view_of_png(py, &content) {
        Some(view) if views().any(|hash| hash == view) => RecordedPart::Image(hex(&view)),
        _ if content.starts_with(PNG_SIGNATURE) => RecordedPart::Png(content),
        _ => RecordedPart::Text(format!(
            "[an image ({kind}, {} bytes) that is not kept]",
            content.len()
        )),
    }
}

fn json(value: &Bound<'_, PyAny>) -> PyResult<String> {
    let py = value.py();
    let options = PyDict::new(py);
    options.set_item("ensure_ascii", false)?;
    options.set_item("separators", (",", ":"))?;
    options.set_item("default", py.get_type::<PyString>())?;
    let text = py.import("json")?.call_method("dumps", (value,), Some(&options))?;
    lossy(text.cast()?)
}
