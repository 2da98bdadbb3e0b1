"""What MkDocs needs to build the site from the Markdown files where they are: pages, navigation and links.

MkDocs calls the functions `on_...`. It checks links and headings itself; a warning ends the build.
"""

import json
import logging
import re
import subprocess
from itertools import pairwise
from pathlib import Path
from posixpath import dirname, join, normpath
from typing import Any
from xml.etree.ElementTree import Element

from markdown import Markdown
from markdown.extensions import Extension
from markdown.treeprocessors import Treeprocessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
FRONT = "README.md"
# The page that lists the others, which is the navigation.
LIST = "docs/README.md"
# No pages: a template of one, and files about the code beside them.
NO_PAGES = ("shm-types/", "crates/")

log = logging.getLogger("mkdocs.hooks")


def output_of(*command: str) -> str:
    """Returns what a command at the root of the repository prints."""
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


FILES = {name for name in output_of("git", "ls-files", "-z").split("\0") if (ROOT / name).is_file()}
FOLDERS = {parent.as_posix() for name in FILES for parent in Path(name).parents}
PAGES = {name for name in FILES if name.endswith(".md") and not name.startswith(NO_PAGES)}
COMMIT = output_of("git", "rev-parse", "HEAD").strip()
PACKAGES = json.loads(output_of("cargo", "metadata", "--no-deps", "--format-version", "1"))["packages"]


def resolve(page: str, path: str) -> str:
    """Returns what a relative path in a page names; of a folder with a README, the README."""
    name = normpath(join(dirname(page), path))
    readme = normpath(join(name, "README.md"))
    return readme if readme in PAGES else name


class Links(Treeprocessor):
    """Leads links to folders to their README, and links to other files to the published repository."""

    page = FRONT

    def run(self, root: Element) -> None:
        for link in root.iter("a"):
            path, hash_sign, anchor = link.get("href", "").partition("#")
            if not path or ":" in path:
                continue
            name = resolve(self.page, path)
            if name in PAGES:
                depth = "../" * self.page.count("/")
                link.set("href", depth + name + hash_sign + anchor)
            elif name in FILES | FOLDERS:
                kind = "blob" if name in FILES else "tree"
                address = f"{PACKAGES[0]['repository']}/{kind}/{COMMIT}/{name}"
                link.set("href", address + hash_sign + anchor)


class LinksExtension(Extension):
    """Has `Links` run after Markdown is read and before MkDocs checks links."""

    def extendMarkdown(self, md: Markdown) -> None:
        md.treeprocessors.register(Links(md), "links", 10)


def listed(page: str, text: str) -> list[str]:
    """Returns the pages that a text of a page links, without those that it links a heading of."""
    names = [resolve(page, path) for path in re.findall(r"\]\(([^)#:\s]+)\)", text)]
    return [name for name in dict.fromkeys(names) if name in PAGES]


def entry(name: str) -> Any:
    """Returns the entry of a page in the navigation; of a README, with the pages of its folder that it links."""
    text = (ROOT / name).read_text()
    folder = dirname(name) + "/"
    inner = listed(name, text) if name.endswith("/README.md") else []
    inner = [page for page in inner if page.startswith(folder)]
    return {text.partition("\n")[0].removeprefix("# "): [name, *inner]} if inner else name


def reference() -> dict[str, str]:
    """Returns the pages of the Python package's reference: the package, then its modules by name."""
    modules = sorted(re.findall(r"^python/memtransfer/([a-z]\w*)\.py$", "\n".join(FILES), re.MULTILINE))
    # Every other name of the package is of a module.
    options = {"memtransfer": "    options:\n      members: [Frame]\n"}
    names = ["memtransfer", *(f"memtransfer.{module}" for module in modules)]
    return {f"python/reference/{name}.md": f"# {name}\n\n::: {name}\n{options.get(name, '')}" for name in names}


def on_config(config: MkDocsConfig) -> None:
    sections = (ROOT / LIST).read_text().split("\n## ")[1:]
    config.nav = [
        FRONT,
        LIST,
        *({section.partition("\n")[0]: [entry(name) for name in listed(LIST, section)]} for section in sections),
        {"Python reference": list(reference())},
    ]
    config.markdown_extensions.append(LinksExtension())  # type: ignore[arg-type]


def on_files(files: Files, config: MkDocsConfig) -> None:
    for name in sorted(FILES):
        is_image = name.startswith(("docs/", "examples/")) and name.endswith((".png", ".svg"))
        if name in PAGES or is_image:
            files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    for name, text in reference().items():
        files.append(File.generated(config, name, content=text))


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> None:
    name = page.file.src_uri
    Links.page = name
    # In the search, what was decided or changed comes after what is.
    if name.startswith("docs/decisions/") or name == "CHANGELOG.md":
        page.meta["search"] = {"boost": 0.2}
    else:
        check_commands(name, markdown)
    check_lists(name, markdown)


def check_commands(name: str, markdown: str) -> None:
    """Warns of commands for cargo that name no package of the workspace, or no example of one. Capitals stand for any."""
    command = r"cargo .*(?:-p|--package) ([a-z][\w-]*)(?:.* --example ([a-z][\w-]*))?"
    for package, example in re.findall(command, markdown):
        targets = [target["name"] for each in PACKAGES if each["name"] == package for target in each["targets"]]
        if not targets:
            log.warning("%s: cargo has no package %s", name, package)
        elif example and example not in targets:
            log.warning("%s: package %s has no example %s", name, package, example)


def check_lists(name: str, markdown: str) -> None:
    """Warns of lists that a code host shows and MkDocs does not: those without an empty line before, or with a smaller indent."""
    text = re.sub(r"^( *)```.*?^\1```", "", markdown, flags=re.DOTALL | re.MULTILINE)
    for before, line in pairwise(text.splitlines()):
        is_item = re.match(r" {0,3}([-*+]|\d+\.) ", line)
        if is_item and (line.startswith(" ") or re.match(r"[^\s\-*+\d]", before)):
            log.warning("%s: put an empty line before the list, and four spaces before one in a list: %s", name, line)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> None:
    for load in re.findall(r"<(?!a )\w+[^>]* (?:src|href|data|srcset)=\"?(?:https?:)?//[^>]*", output):
        log.warning("%s: the page loads from another host: %s", page.file.src_uri, load)
