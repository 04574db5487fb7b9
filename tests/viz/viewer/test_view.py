"""`tb2rl.view`: a page in a notebook, for a policy or an environment."""

import urllib.request

import pytest

from tb2rl import InputError, load, make_env, view


@pytest.fixture
def shown():
    """A function that makes a view, which is closed after the test."""
    views = []

    def show(*arguments, **settings):
        views.append(view(*arguments, **settings))
        return views[-1]

    yield show
    for each in views:
        each.close()


@pytest.mark.parametrize("is_loaded", [False, True])
def test_a_policy_drives_on_a_page_in_the_cell(is_loaded, shown):
    name = "zoo:maze-loop-qlearn"
    page = shown(load(name) if is_loaded else name, world="circuit", height=400)
    assert f"<iframe src='{page.url}'" in page._repr_html_()
    assert "height:400px" in page._repr_html_()
    with urllib.request.urlopen(page.url) as response:
        assert response.status == 200


def test_settings_that_do_not_fit_are_named(shown):
    with pytest.raises(InputError, match="trained with other observations or actions"):
        shown("zoo:maze-loop-ppo", beams=7)


def test_other_environments_and_settings_of_an_environment_are_refused(shown):
    with pytest.raises(InputError, match="give them to make_env"):
        shown(make_env(simulation="kinematic"), world="circuit")


def test_an_environment_with_a_page_keeps_it(shown):
    env = make_env(simulation="kinematic", render_mode="human")
    assert shown(env).server is env.viewer.server
    env.close()
