defmodule Phoenix.LiveViewTest.DOMTest do
  use ExUnit.Case, async: true

  alias Phoenix.LiveViewTest.DOM

  @page DOM.parse(
          ~s(<ul id="l"><li id="a" class="row busy" data-n="1">A</li><li id="b" class="row">B</li></ul>)
        )

  defp ids(selector),
    do: for({_tag, attributes, _children} <- DOM.all(@page, selector), {"id", id} <- attributes, do: id)

  test "selectors: together, descendants, children, alternatives, and what is not" do
    assert ids("li.row") == ["a", "b"]
    assert ids("#l > li:not(.busy)") == ["b"]
    assert ids("#a:not(.busy)") == []
    assert ids(".row:not([data-n='1'])") == ["b"]
    assert ids("ul li.busy, #b") == ["a", "b"]
    assert ids("*:not(ul)") == ["a", "b"]
  end

  test "what it does not know it does not ignore" do
    for selector <- ["li:hover", "li:nth-child(2)", "li:not(ul li)", "[data-n=1]", "#1"],
        do: assert_raise(ArgumentError, fn -> ids(selector) end)
  end
end
