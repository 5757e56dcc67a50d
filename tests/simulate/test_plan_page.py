"""The page on planning quotes the commands that its figures come from."""

import runpy


def test_the_commands_of_the_page_are_those_of_the_figures(project_root):
    questions = runpy.run_path(str(project_root / "docs" / "scripts" / "plan_figures.py"))["QUESTIONS"]
    page = (project_root / "docs" / "plan.md").read_text()
    for name, command in questions.items():
        assert f"    fleetlog simulate {command} -o {name}\n" in page
        assert f"figures/plan_{name}.png" in page
        assert (project_root / "docs" / "figures" / f"plan_{name}.png").exists()
