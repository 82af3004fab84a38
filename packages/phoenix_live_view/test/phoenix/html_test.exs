defmodule Phoenix.HTMLTest do
  use ExUnit.Case, async: true
  use Phoenix.Component

  import Phoenix.LiveViewTest, only: [rendered_to_string: 1]

  alias Phoenix.HTML
  alias Phoenix.HTML.Form

  defp text(value), do: value |> HTML.html_escape() |> HTML.safe_to_string()

  for {value, html} <- [
        {quote(do: nil), ""},
        {quote(do: :a), "a"},
        {quote(do: ["a", ?<, [~c"b"], {:safe, "<i>"}]), "a&lt;b<i>"},
        {quote(do: ["a" | "b"]), "ab"},
        {quote(do: {:safe, "<b>"}), "<b>"},
        {quote(do: ~D[2026-01-02]), "2026-01-02"},
        {quote(do: ~T[01:02:03]), "01:02:03"},
        {quote(do: ~N[2026-01-02 01:02:03]), "2026-01-02 01:02:03"},
        {quote(do: ~U[2026-01-02 01:02:03Z]), "2026-01-02 01:02:03Z"},
        {quote(do: URI.parse("/a?b=1&c='")), "/a?b=1&amp;c=&#39;"},
        {quote(do: Version.parse!("1.2.3")), "1.2.3"}
      ] do
    test "text of #{Macro.to_string(value)}", do: assert(text(unquote(value)) == unquote(html))
  end

  test "what has no text is an error" do
    assert_raise Protocol.UndefinedError, fn -> text({:a, 1}) end
    assert_raise ArgumentError, fn -> text([:a]) end
  end

  test "attributes, and names that would end one" do
    given = [id: 1, class: ["a", nil, ["b"]], data_a_b: 2, aria_label: "<", x: nil, y: false, z: true]

    assert HTML.safe_to_string(HTML.attributes_escape(given)) ==
             ~s( id="1" class="a b" data-a-b="2" aria-label="&lt;" z)

    for name <- ["a b", "a>", "", "a\"", "a=b"],
        do: assert_raise(ArgumentError, fn -> HTML.attributes_escape([{name, "1"}]) end)
  end

  test "options of a select" do
    options = [{"One", 1}, {"<2>", 2}, 3]

    assert HTML.safe_to_string(Form.options_for_select(options, [2, "3"])) ==
             ~s(<option value="1">One</option><option value="2" selected>&lt;2&gt;</option><option value="3" selected>3</option>)
  end

  for {name, template, html} <- [
        {"href", ~s(<.link href="/a" class="x">t</.link>), ~s(<a href="/a" class="x">t</a>)},
        {"href none", ~s(<.link>t</.link>), ~s(<a href="#">t</a>)},
        {"patch", ~s(<.link patch="/a">t</.link>),
         ~s(<a href="/a" data-phx-link="patch" data-phx-link-state="push">t</a>)},
        {"navigate", ~s(<.link navigate="/a" replace data-x="1">t</.link>),
         ~s(<a href="/a" data-phx-link="redirect" data-phx-link-state="replace" data-x="1">t</a>)},
        {"title", ~s(<.live_title default="d" prefix="p ">{nil}</.live_title>),
         ~s(<title data-prefix="p " data-default="d">p d</title>)},
        {"title given", ~s(<.live_title>t</.live_title>), "<title>t</title>"}
      ] do
    test "component: #{name}" do
      assigns = %{}

      found =
        unquote(
          {:sigil_H, [line: __ENV__.line, delimiter: "\""], [{:<<>>, [line: __ENV__.line], [template]}, []]}
        )
        |> rendered_to_string()
        |> String.replace(~r/\n */, "")
        |> String.trim()

      assert found == unquote(html)
    end
  end

  test "links lead to pages, not to code" do
    assigns = %{to: "javascript:alert(1)"}

    for rendered <- [
          fn -> ~H"<.link href={@to}>t</.link>" end,
          fn -> ~H"<.link patch={@to}>t</.link>" end,
          fn -> ~H"<.link navigate={@to}>t</.link>" end
        ] do
      assert_raise ArgumentError, ~r/unsupported scheme/, rendered
    end
  end

  test "assigns" do
    socket =
      %Phoenix.LiveView.Socket{}
      |> assign(:a, 1)
      |> assign(%{b: 2})
      |> update(:a, &(&1 + 1))

    assert %{a: 2, b: 2, __changed__: %{a: true, b: true} = changed} = socket.assigns
    assert map_size(changed) == 2
    same = %{socket | assigns: %{socket.assigns | __changed__: %{}}}
    assert assign(same, :a, 2) == same
    assert_raise ArgumentError, ~r/reserved/, fn -> assign(socket, :flash, %{"a" => 1}) end
    assert_raise ArgumentError, fn -> assign(%{}, :a, 1) end
  end
end
