//! A method of remembering, which makes one memory for each bank.

use std::sync::Arc;

use case_book::WorldDeclaration;
use shm_types::MemoryDescription;

use super::Memory;
use crate::error::ServeError;

/// Makes memories.
pub trait MemoryMethod {
    /// What the method is called and needs. [`MemoryDescription::sdk`] and [`MemoryDescription::code`] are
    /// filled in if they are empty.
    fn describe(&self) -> MemoryDescription;

    /// A memory for one bank of demonstrations in `world`, which says what states, actions and feedback mean.
    fn create(&self, world: &Arc<WorldDeclaration>) -> Box<dyn Memory + '_>;

    /// Called before anything is sent, and a few times a second while there is nothing to do.
    ///
    /// # Errors
    /// When serving has to end, for example with [`ServeError::Interrupted`]: what a memory returned last is not sent then.
    fn check(&self) -> Result<(), ServeError> {
        Ok(())
    }
}

/// A [`MemoryMethod`] of a description and a function that makes memories.
#[derive(Debug, Clone)]
pub struct Method<F> {
    description: MemoryDescription,
    create: F,
}

impl<M: Memory + 'static, F: Fn() -> M> Method<F> {
    /// Every memory is what `create` returns.
    pub fn new(description: MemoryDescription, create: F) -> Self {
        Self { description, create }
    }
}

impl<M: Memory + 'static, F: Fn() -> M> MemoryMethod for Method<F> {
    fn describe(&self) -> MemoryDescription {
        self.description.clone()
    }

    fn create(&self, _world: &Arc<WorldDeclaration>) -> Box<dyn Memory + '_> {
        Box::new((self.create)())
    }
}
