//! A video of the views, made by ffmpeg.

use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, bail};

use crate::moments::{EpisodeSink, Moments, Timing};

/// ffmpeg as a child process that reads JPEG files and writes a video.
pub(crate) struct Video {
    child: Child,
    images: Option<ChildStdin>,
    messages: Option<JoinHandle<String>>,
}

impl Video {
    /// Starts ffmpeg, which writes to `path`. The `comment` is kept in the file.
    pub(crate) fn create(path: &Path, comment: &str, timing: Timing) -> Result<Self> {
        let rate = timing.steps_per_s.to_string();
        let started = Command::new("ffmpeg")
            .args(["-hide_banner", "-loglevel", "error", "-nostdin", "-y"])
            .args(["-f", "image2pipe", "-c:v", "mjpeg", "-framerate", &rate, "-i", "pipe:0"])
            // Players of all kinds know H.264 with these pixels; the index comes first, so that it can be streamed.
            .args(["-c:v", "libx264", "-preset", "veryfast", "-pix_fmt", "yuv420p"])
            .args(["-movflags", "+faststart"])
            .args(["-metadata", &format!("comment={comment}")])
            .args(["-f", "mp4"])
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = match started {
            Ok(child) => child,
            Err(error) if error.kind() == ErrorKind::NotFound => bail!(
                "a video needs ffmpeg, which is not in PATH: install it (`apt-get install ffmpeg` on Debian or \
                 Ubuntu), or use --format mcap"
            ),
            Err(error) => return Err(error).context("cannot start ffmpeg"),
        };
        let images = child.stdin.take();
        // Read from another thread, so that ffmpeg never waits for a reader.
        let messages = child.stderr.take().map(|mut pipe| {
            std::thread::Builder::new().spawn(move || {
                let mut text = Vec::new();
                // What cannot be read is missing from an error message.
                let _ = pipe.read_to_end(&mut text);
                String::from_utf8_lossy(&text).trim().to_owned()
            })
        });
        let messages = messages.transpose().context("cannot start a thread")?;
        Ok(Self { child, images, messages })
    }

    /// Waits for ffmpeg and says why it failed, if it did.
    fn end(&mut self) -> Result<()> {
        self.images = None;
        let status = self.child.wait().context("cannot wait for ffmpeg")?;
        let messages = self.messages.take().and_then(|reader| reader.join().ok());
        if !status.success() {
            bail!("ffmpeg failed ({status}): {}", messages.unwrap_or_default());
        }
        Ok(())
    }
}

impl EpisodeSink for Video {
    fn episode(&mut self, moments: &Moments<'_>) -> Result<()> {
        for step in &moments.timeline.steps {
            let image = moments.images.get(&step.view).context("a view was not rendered")?;
            let written = self.images.as_mut().map(|pipe| pipe.write_all(image));
            if !matches!(written, Some(Ok(()))) {
                self.end()?;
                return Err(anyhow!("ffmpeg ended early"));
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.end()
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        // It has ended already, unless an episode failed.
        self.images = None;
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
