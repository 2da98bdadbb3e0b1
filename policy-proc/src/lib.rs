//! The built-in policies: an observation, a window and a recall in, an action out.
//!
//! - [`openai`]: asks a vision-language model. The `prompt` crate words the request, the `llm` crate sends it;
//! - [`grounded`]: a scripted stand-in that reads label plates and needs no model;
//! - [`imitate`]: a scripted stand-in for any world, which does what the expert did;
//! - [`random`]: the lower bound.
//!
//! All are written against the `peer` SDK. This crate does not link `warehouse`: what a policy knows about the world, it
//! has seen in its requests.

pub mod grounded;
pub mod imitate;
pub mod openai;
pub mod random;
