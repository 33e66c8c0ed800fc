"""Completion in bash: words and files together, and no blank after a key of --set.

Click's own script answers with words or with files, and does not join what bash divides
at `=`. A word that is a file alone is left to bash, which knows about quotes and ~.
"""

from __future__ import annotations

from collections.abc import Sequence

from click.shell_completion import BashComplete, CompletionItem, add_completion_class

SCRIPT = """\
%(complete_func)s() {
    local IFS=$'\\n' kind value files= word=${COMP_WORDS[COMP_CWORD]}
    [[ $word == = ]] && word=
    COMPREPLY=()
    while IFS=, read -r kind value; do
        case $kind in
            file) files=1 ;;
            plain) COMPREPLY+=("$value"); [[ $value == *= ]] && compopt -o nospace ;;
        esac
    done < <(env COMP_WORDS="${COMP_WORDS[*]}" COMP_CWORD=$COMP_CWORD \\
        %(complete_var)s=bash_complete "$1")
    if [[ $files && ${#COMPREPLY[@]} -gt 0 ]]; then
        compopt -o filenames
        COMPREPLY+=($(compgen -f -- "$word"))
    elif [[ ! $files ]]; then
        compopt +o default
    fi
}
complete -o default -o nosort -F %(complete_func)s %(prog_name)s
"""


@add_completion_class
class Bash(BashComplete):
    """Click's completion of bash, with a script of our own."""

    source_template = SCRIPT
    before = ""
    """What stands before the last word of bash, and is in the word that is completed.
    """

    def get_completion_args(self) -> tuple[list[str], str]:
        """Return the complete words, and the beginning of the word to complete."""
        args, incomplete = super().get_completion_args()
        *args, joined = join_at_equals([*args, incomplete])
        self.before = joined.removesuffix("" if incomplete == "=" else incomplete)
        return args, joined

    def format_completion(self, item: CompletionItem) -> str:
        """Return a completion as `kind,text` for the script in bash."""
        return f"{item.type},{item.value.removeprefix(self.before)}"


def join_at_equals(words: Sequence[str]) -> list[str]:
    """Return words, at least one, as they were before bash divided them at `=`.

    `--method = con` are an option and its value, `k = 1` is one word.
    """
    joined: list[str] = []
    for word, previous in zip(words, ["", *words], strict=False):
        is_sign = word == "=" and bool(joined)
        if is_sign and joined[-1].startswith("--"):
            joined.append("")
        elif is_sign or (previous == "=" and joined):
            joined[-1] += word
        else:
            joined.append(word)
    return joined
