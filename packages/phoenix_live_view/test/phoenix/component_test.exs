defmodule Phoenix.ComponentTest do
  use ExUnit.Case, async: true
  use Phoenix.Component

  alias Phoenix.LiveView.Template.Error

  defp html(rendered), do: rendered |> Phoenix.HTML.Safe.to_iodata() |> IO.iodata_to_binary()

  attr :level, :atom, values: [:info, :warning], default: :info
  attr :rest, :global
  slot :inner_block, required: true

  slot :action do
    attr :label, :string, required: true
  end

  defp notice(assigns) do
    ~H"""
    <p class={["notice", @level, nil, false]} {@rest}>{render_slot(@inner_block, @level)}<b :for={a <- @action}>{a.label}{render_slot(a, 1)}</b></p>
    """
  end

  test "text is escaped, numbers, nil and true are text" do
    assigns = %{a: "<&\"'>", n: 1, f: 1.5, nothing: nil, yes: true, safe: {:safe, "<i>"}}

    assert html(~H"<p title={@a}>{@a}|{@n}|{@f}|{@nothing}|{@yes}|{@safe}</p>") ==
             ~s(<p title="&lt;&amp;&quot;&#39;&gt;">&lt;&amp;&quot;&#39;&gt;|1|1.5||true|<i></p>)
  end

  test "braces in expressions, strings with braces, comments and raw elements" do
    assigns = %{m: %{a: 1}}

    assert html(~H({%{@m | a: 2}.a}{"}"}<%!-- {gone} --%><!-- {kept} --><style>a { b: c }</style>)) ==
             "2}<!-- {kept} --><style>a { b: c }</style>"
  end

  test "attributes: nil and false are left out, true is the name alone, lists of classes are flat" do
    assigns = %{on: true, off: false, none: nil, list: ["a", [nil, "b"], false], rest: [id: 1, data_x: 2]}

    assert html(~H"<input disabled={@on} checked={@off} title={@none} class={@list} {@rest} required>") ==
             ~s(<input disabled class="a b" id="1" data-x="2" required>)
  end

  test "components: defaults, globals, slots with arguments" do
    assigns = %{}

    assert html(~H"""
           <.notice id="x" phx-click="go" :let={level}>seen {level}<:action label="A" :let={n}>{n}</:action><:action label="B" /></.notice>
           """) =~ ~s(<p class="notice info" id="x" phx-click="go">seen info<b>A1</b><b>B</b></p>)
  end

  test ":if and :for, with keys" do
    assigns = %{rows: [%{id: 1, on: true}, %{id: 2, on: false}]}

    assert html(
             ~H"<li :for={%{id: id} = row <- @rows} :if={row.on} :key={id}>{id}</li><b :if={@rows == []}>none</b>"
           ) == "<li>1</li>"
  end

  test "one element is a root, also with space around it; two, or one with :if, are not" do
    assigns = %{}

    assert ~H"""
           <p>x</p>
           """.root

    refute ~H"<p></p><p></p>".root
    refute ~H"<p :if={true}></p>".root
  end

  test "two rows with one key are an error" do
    assigns = %{}
    assert_raise ArgumentError, ~r/same :key/, fn -> ~H"<p :for={i <- [1, 1]} :key={i}></p>" end
  end

  test "the error for a missing assign names it" do
    assigns = %{there: 1}
    assert_raise KeyError, ~r/@gone is not there.*:there/, fn -> ~H"{@gone}" end
  end

  for {source, words} <- [
        {"<p>", "t.ex:1:1: <p> is not closed"},
        {"<p></b>", "</b> does not close <p>"},
        {"</p>", "</p> closes nothing"},
        {"<p a=1>", "value of a in quotes or braces"},
        {"<p a={1 + }>", "expected } to end"},
        {"<%= 1 %>", "use {…}"},
        {"a } b", "} without {"},
        {"<p :if>x</p>", "expected an expression: :if"},
        {"<p :unless={1}>x</p>", "unknown :unless"},
        {"<p :for={x}>x</p>", "expected :for={pattern <- enumerable}"},
        {"<:a>x</:a>", "must be directly inside a component"},
        {"<!-- a", "expected -->"},
        {"<script>", "expected </script>"},
        {"<p", "expected the end of the tag"},
        {"\n <p a=\"x>", "t.ex:2:"}
      ] do
    test "a mistake is reported with its place: #{inspect(source)}" do
      error = catch_error(Phoenix.LiveView.Template.Compiler.compile(unquote(source), file: "t.ex"))
      assert %Error{} = error
      assert Exception.message(error) =~ unquote(words)
    end
  end
end
