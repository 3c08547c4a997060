"""What is to be estimated: the orders of the model and the nuisance terms beside it."""

from tridentify.structure.structure import AutoStructure, InitialState, Structure

__all__ = ["AutoStructure", "InitialState", "Structure"]
