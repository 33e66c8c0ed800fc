"""The former name of `result`, until every pipeline imports that."""

from shapefit.pipelines.result import Counted, Failure, Note, add_up, nothing_in, unread
from shapefit.pipelines.result import Result as Outcome

__all__ = ["Counted", "Failure", "Note", "Outcome", "add_up", "nothing_in", "unread"]
