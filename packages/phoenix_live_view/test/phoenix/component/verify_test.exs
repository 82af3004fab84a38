defmodule Phoenix.Component.VerifyTest do
  # Captures standard error, which all tests share.
  use ExUnit.Case, async: false

  import ExUnit.CaptureIO

  # What the compiler says about templates that call these.
  defp warnings(template) do
    id = System.unique_integer([:positive])

    source = """
    defmodule Phoenix.Component.VerifyTest.Page#{id} do
      use Phoenix.Component

      attr :label, :string, required: true
      attr :level, :atom, values: [:info, :warning], default: :info
      attr :count, :integer
      attr :rest, :global, include: ~w(form)
      slot :inner_block

      slot :col do
        attr :name, :string, required: true
      end

      defp card(assigns), do: ~H"{@label}{@level}{render_slot(@inner_block)}{length(@col)}"

      attr :id, :string, required: true
      def plain(assigns), do: ~H"{@id}"

      def page(assigns) do
        ~H\"""
        #{template}
        \"""
      end
    end
    """

    capture_io(:stderr, fn -> Code.compile_string(source, "page.ex") end)
  end

  @card ~s(<.card label="x" />)

  test "a call as declared, in part at run time, or of what declares nothing, gives no warning" do
    assert warnings(
             ~s(<.card label="x" level={:info} count={1} data-x="1" form="f" phx-click="go">text</.card>)
           ) == ""

    assert warnings(~s(<.card {@all} /><.plain id={@id} />)) == ""
    assert warnings(@card <> ~s(<.card label={@x}><:col name="a">1</:col></.card>)) == ""
    assert warnings(@card <> ~s(<.page />)) == ""
  end

  for {template, words} <- [
        {"<.card />", ~s(missing required attribute "label" for component)},
        {~s(<.card label="x" odd="1" />), ~s(undefined attribute "odd" for component)},
        {~s(<.card label={1} />), ~s(attribute "label" in component)},
        {~s(<.card label="x" level={:loud} />), "must be one of [:info, :warning], got: :loud"},
        {~s(<.card label="x" count="1" />), "must be an :integer, got: \"1\""},
        {~s(<.card label="x"><:row /></.card>), ~s(undefined slot "row")},
        {~s(<.card label="x"><:col /></.card>), ~s(missing required attribute "name" in slot "col")},
        {~s(<.card label="x"><:col name="a" odd="1" /></.card>), ~s(undefined attribute "odd" in slot "col")},
        {~s(<p><.card label="x"><b :if={true}><.plain /></b></.card></p>),
         ~s(missing required attribute "id")},
        {@card <> "<.plain id=\"a\">text</.plain>", ~s(undefined slot "inner_block")},
        {@card <> "<.live_title />",
         ~s(missing required slot "inner_block" for component Phoenix.Component.Elements.live_title/1)}
      ] do
    test "a warning with its line: #{template}" do
      warnings = warnings("<.card label=\"x\" />\n    " <> unquote(template))
      assert warnings =~ unquote(words)
      assert warnings =~ "page.ex:22"
    end
  end

  for {declaration, words} <- [
        {"attr :a, :odd", "unknown type :odd"},
        {"attr :a, :string, odd: 1", "unknown options [:odd]"},
        {"attr :a, :string, required: true, default: 1", "required and with a default"},
        {"attr :a, :string\nattr :a, :any", "declared twice"},
        {"slot :s do\n attr :a, :string, default: 1\nend", "unknown options [:default]"}
      ] do
    test "a declaration that makes no sense is an error: #{inspect(declaration)}" do
      source = """
      defmodule Phoenix.Component.VerifyTest.Wrong do
        use Phoenix.Component
        #{unquote(declaration)}
        def wrong(assigns), do: ~H""
      end
      """

      assert_raise CompileError, ~r/#{Regex.escape(unquote(words))}/, fn ->
        Code.compile_string(source, "wrong.ex")
      end
    end
  end

  test "an error in a template in a heredoc has its line and column" do
    source = """
    defmodule Phoenix.Component.VerifyTest.Broken do
      use Phoenix.Component

      def page(assigns) do
        ~H\"""
        <p>
          <b>{@x}</i>
        </p>
        \"""
      end
    end
    """

    error = catch_error(Code.compile_string(source, "broken.ex"))
    assert Exception.message(error) =~ "broken.ex:7:14: </i> does not close <b>"
  end
end
