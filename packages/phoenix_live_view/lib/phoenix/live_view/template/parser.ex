defmodule Phoenix.LiveView.Template.Parser do
  @moduledoc """
  Parses tokens into a tree of elements. Pure.

  Nodes: `{:text, text}`, `{:expr, quoted, meta}`, `{:element, kind, name, attributes, children, meta}`. Elements that are not
  closed, or closed in the wrong order, are errors.
  """

  alias Phoenix.LiveView.Template.{Error, Tokenizer}

  @type tree ::
          {:text, String.t()}
          | {:expr, Macro.t(), Tokenizer.meta()}
          | {:element, Tokenizer.kind(), String.t(), [Tokenizer.attribute()], [tree()], Tokenizer.meta()}

  @doc "The tree of a source. Options as `Phoenix.LiveView.Template.Tokenizer.tokenize/2`. Raises `Template.Error`."
  @spec parse(String.t(), keyword()) :: [tree()]
  def parse(source, options \\ []) do
    file = Keyword.get(options, :file, "nofile")
    source |> Tokenizer.tokenize(options) |> build([], [], file)
  end

  # `open` are the enclosing elements, each with the nodes before it.
  defp build([], done, [], _file), do: Enum.reverse(done)

  defp build([], _done, [{{:open, kind, name, _attributes, meta}, _before} | _open], file),
    do: Error.raise!(file, meta, "<#{label(kind, name)}> is not closed")

  defp build([{:open, kind, name, _attributes, %{close: :none}} = token | rest], done, open, file) do
    slot!(kind, name, token, open, file)
    build(rest, [], [{token, done} | open], file)
  end

  defp build([{:open, kind, name, attributes, meta} = token | rest], done, open, file) do
    slot!(kind, name, token, open, file)
    build(rest, [{:element, kind, name, attributes, [], meta} | done], open, file)
  end

  defp build(
         [{:close, kind, name, _meta} | rest],
         done,
         [{{:open, kind, name, attributes, meta}, before} | open],
         file
       ),
       do: build(rest, [{:element, kind, name, attributes, Enum.reverse(done), meta} | before], open, file)

  defp build([{:close, kind, name, meta} | _rest], _done, [], file),
    do: Error.raise!(file, meta, "</#{label(kind, name)}> closes nothing")

  defp build([{:close, kind, name, meta} | _rest], _done, [{{:open, above, other, _, at}, _} | _open], file) do
    Error.raise!(
      file,
      meta,
      "</#{label(kind, name)}> does not close <#{label(above, other)}> of line #{at.line}"
    )
  end

  defp build([other | rest], done, open, file), do: build(rest, [other | done], open, file)

  defp slot!(:slot, _name, _token, [{{:open, :component, _, _, _}, _} | _open], _file), do: :ok

  defp slot!(:slot, name, {:open, _, _, _, meta}, _open, file),
    do: Error.raise!(file, meta, "the slot <:#{name}> must be directly inside a component")

  defp slot!(_kind, _name, _token, _open, _file), do: :ok

  defp label(:slot, name), do: ":" <> name
  defp label(_kind, name), do: name
end
