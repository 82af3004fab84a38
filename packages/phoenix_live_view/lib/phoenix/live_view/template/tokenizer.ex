defmodule Phoenix.LiveView.Template.Tokenizer do
  @moduledoc """
  Splits template source into tokens. Pure.

  Tokens:

    * `{:text, text}`: markup without tags, comments included, as it is
    * `{:expr, quoted, meta}`: `{…}` in the text
    * `{:open, kind, name, attributes, meta}`: `meta.close` is `:none`, `:self` (`<br />`) or `:void` (`<br>`)
    * `{:close, kind, name, meta}`

  Kinds are `:tag`, `:component` (`<.name>`, `<Module.name>`) and `:slot` (`<:name>`). An attribute is `{name, value, meta}` with
  the value `true`, `{:text, text}` or `{:expr, quoted}`; the name `:root` stands for `{@rest}`.

  An expression ends at the first `}` that makes it valid Elixir, so it may contain braces. The contents of `<script>` and
  `<style>` are text.
  """

  alias Phoenix.LiveView.Template.Error

  @void ~w(area base br col embed hr img input link meta param source track wbr)
  @raw ~w(script style)
  @space [?\s, ?\t, ?\n, ?\r, ?\f]

  @type meta :: %{
          required(:line) => pos_integer(),
          required(:column) => pos_integer(),
          optional(:close) => atom()
        }
  @type value :: true | {:text, String.t()} | {:expr, Macro.t()}
  @type attribute :: {String.t() | :root, value(), meta()}
  @type kind :: :tag | :component | :slot
  @type token ::
          {:text, String.t()}
          | {:expr, Macro.t(), meta()}
          | {:open, kind(), String.t(), [attribute()], meta()}
          | {:close, kind(), String.t(), meta()}

  @doc "The tokens of a source. Options: `:file`, `:line` and `:column` of its first character, `:indentation` that was taken from its other lines. Raises `Template.Error`."
  @spec tokenize(String.t(), keyword()) :: [token()]
  def tokenize(source, options \\ []) do
    state = %{
      file: Keyword.get(options, :file, "nofile"),
      line: Keyword.get(options, :line, 1),
      column: Keyword.get(options, :column, 1),
      indentation: Keyword.get(options, :indentation, 0),
      tokens: []
    }

    text(source, [], state)
  end

  defp text("", buffer, state), do: state |> flush(buffer) |> Map.fetch!(:tokens) |> Enum.reverse()

  defp text("<!--" <> rest, buffer, state) do
    {comment, rest} = until(rest, "-->", state, "<!--")
    text(rest, [buffer, "<!--", comment], walk(state, "<!--" <> comment))
  end

  defp text("<%!--" <> rest, buffer, state) do
    {comment, rest} = until(rest, "--%>", state, "<%!--")
    text(rest, buffer, walk(state, "<%!--" <> comment))
  end

  defp text("<%" <> _rest, _buffer, state) do
    error(state, "<% %> is not supported: use {…}, :if, :for, or a function component with several clauses")
  end

  defp text("<!" <> rest, buffer, state), do: text(rest, [buffer, "<!"], walk(state, "<!"))

  defp text("</" <> rest, buffer, state) do
    state = flush(state, buffer)
    {name, after_name} = name(rest)
    {_space, after_space} = space(after_name)

    case after_space do
      ">" <> rest when name != "" ->
        {kind, name} = kind(name)
        token = {:close, kind, name, meta(state)}
        state = walk(%{state | tokens: [token | state.tokens]}, consumed("</" <> after_name, after_name))
        state = walk(state, consumed(after_name, after_space) <> ">")
        text(rest, [], state)

      _other ->
        error(state, "expected the end of a closing tag: </name>")
    end
  end

  defp text("<" <> <<character, _::binary>> = source, buffer, state)
       when character in ?a..?z or character in ?A..?Z or character in [?., ?:] do
    "<" <> rest = source
    open(rest, flush(state, buffer))
  end

  defp text("{" <> rest, buffer, state) do
    state = flush(state, buffer)
    {quoted, code, rest} = expression(rest, state)

    tokens =
      if quoted == {:__block__, [], []}, do: state.tokens, else: [{:expr, quoted, meta(state)} | state.tokens]

    text(rest, [], walk(%{state | tokens: tokens}, "{" <> code <> "}"))
  end

  defp text("}" <> _rest, _buffer, state) do
    error(state, "} without {: write &rbrace; or {\"}\"} for a brace")
  end

  defp text(<<character::utf8, rest::binary>>, buffer, state),
    do: text(rest, [buffer, <<character::utf8>>], walk(state, <<character::utf8>>))

  defp open(source, state) do
    {name, rest} = name(source)
    start = meta(state)
    if name in [".", ":", ""], do: error(state, "expected a name after <")
    {kind, label} = kind(name)
    state = walk(state, "<" <> name)
    {attributes, rest, state} = attributes(rest, [], state)
    {close, rest, state} = tag_end(rest, state, start)
    close = if kind == :tag and label in @void, do: :void, else: close
    token = {:open, kind, label, attributes, Map.put(start, :close, close)}
    state = %{state | tokens: [token | state.tokens]}

    cond do
      close != :none -> text(rest, [], state)
      kind == :tag and label in @raw -> raw(rest, label, state)
      true -> text(rest, [], state)
    end
  end

  # The contents of <script> and <style> are not markup.
  defp raw(source, name, state) do
    case :binary.match(source, "</" <> name) do
      {at, _length} ->
        <<inside::binary-size(^at), rest::binary>> = source
        text(rest, inside, walk(state, inside))

      :nomatch ->
        error(state, "expected </#{name}>")
    end
  end

  defp tag_end("/>" <> rest, state, _start), do: {:self, rest, walk(state, "/>")}
  defp tag_end(">" <> rest, state, _start), do: {:none, rest, walk(state, ">")}

  defp tag_end(_other, state, start),
    do: error(Map.merge(state, start), "expected the end of the tag: > or />")

  defp attributes(source, done, state) do
    {space, source} = space(source)
    state = walk(state, space)

    case source do
      "{" <> rest ->
        {quoted, code, rest} = expression(rest, state)
        attribute = {:root, {:expr, quoted}, meta(state)}
        attributes(rest, [attribute | done], walk(state, "{" <> code <> "}"))

      <<character, _::binary>> when character in [?>, ?/] ->
        {Enum.reverse(done), source, state}

      "" ->
        {Enum.reverse(done), source, state}

      _name ->
        {attribute, rest, state} = attribute(source, state)
        attributes(rest, [attribute | done], state)
    end
  end

  defp attribute(source, state) do
    start = meta(state)

    case attribute_name(source, 0) do
      {"", _rest} ->
        error(state, "expected the name of an attribute, got #{inspect(String.first(source))}")

      {name, after_name} ->
        {space, rest} = space(after_name)
        state = walk(state, name)

        case rest do
          "=" <> rest -> value(rest, name, start, walk(state, space <> "="))
          _none -> {{name, true, start}, after_name, state}
        end
    end
  end

  defp value(source, name, start, state) do
    {space, source} = space(source)
    state = walk(state, space)

    case source do
      "{" <> rest ->
        {quoted, code, rest} = expression(rest, state)
        {{name, {:expr, quoted}, start}, rest, walk(state, "{" <> code <> "}")}

      <<quote, rest::binary>> when quote in [?", ?'] ->
        {text, rest} = until(rest, <<quote>>, state, <<quote>>)
        text = binary_part(text, 0, byte_size(text) - 1)
        {{name, {:text, text}, start}, rest, walk(state, <<quote>> <> text <> <<quote>>)}

      _other ->
        error(state, "expected the value of #{name} in quotes or braces")
    end
  end

  # The first } that makes the source valid Elixir.
  defp expression(source, state), do: expression(source, 0, state)

  defp expression(source, from, state) do
    case :binary.match(source, "}", scope: {from, byte_size(source) - from}) do
      :nomatch ->
        error(state, "expected } to end the expression" <> complaint(source, state))

      {at, 1} ->
        code = binary_part(source, 0, at)

        case parse(code, state) do
          {:ok, quoted} -> {quoted, code, binary_part(source, at + 1, byte_size(source) - at - 1)}
          {:error, _reason} -> expression(source, at + 1, state)
        end
    end
  end

  defp parse(code, state) do
    Code.string_to_quoted(code,
      file: state.file,
      line: state.line,
      column: state.column + 1,
      emit_warnings: false
    )
  end

  # Elixir's error about the text up to the last } of the line, which was probably intended.
  defp complaint(source, state) do
    code = source |> String.split("\n", parts: 2) |> hd() |> String.split("}") |> hd()

    case parse(code, state) do
      {:error, {_where, {before, later}, token}} -> " (#{before}#{token}#{later})"
      {:error, {_where, message, token}} -> " (#{message}#{token})"
      {:ok, _quoted} -> ""
    end
  end

  defp kind("." <> _ = name), do: {:component, name}
  defp kind(":" <> name), do: {:slot, name}
  defp kind(<<character, _::binary>> = name) when character in ?A..?Z, do: {:component, name}
  defp kind(name), do: {:tag, name}

  defp name(source), do: span(source, 0, &name?/1)
  defp space(source), do: span(source, 0, &(&1 in @space))

  defp name?(character),
    do:
      character in ?a..?z or character in ?A..?Z or character in ?0..?9 or
        character in [?-, ?_, ?., ?:, ??, ?!]

  defp span(source, at, fits?) do
    case source do
      <<_::binary-size(^at), character, _::binary>> ->
        if fits?.(character), do: span(source, at + 1, fits?), else: split(source, at)

      _end ->
        split(source, at)
    end
  end

  defp attribute_name(source, at) do
    case source do
      <<_::binary-size(^at), character, _::binary>>
      when character not in @space and character not in [?=, ?>, ?/, ?{, ?}, ?", ?', ?<] ->
        attribute_name(source, at + 1)

      _end ->
        split(source, at)
    end
  end

  defp split(source, at), do: {binary_part(source, 0, at), binary_part(source, at, byte_size(source) - at)}
  defp consumed(whole, rest), do: binary_part(whole, 0, byte_size(whole) - byte_size(rest))

  # Up to and including an ending.
  defp until(source, ending, state, opening) do
    case :binary.match(source, ending) do
      {at, length} -> split(source, at + length)
      :nomatch -> error(state, "expected #{ending} to end #{opening}")
    end
  end

  defp flush(state, buffer) do
    case IO.iodata_to_binary(buffer) do
      "" -> state
      text -> %{state | tokens: [{:text, text} | state.tokens]}
    end
  end

  defp walk(state, text) do
    case String.split(text, "\n") do
      [line] ->
        %{state | column: state.column + String.length(line)}

      lines ->
        %{
          state
          | line: state.line + length(lines) - 1,
            column: String.length(List.last(lines)) + 1 + state.indentation
        }
    end
  end

  defp meta(state), do: %{line: state.line, column: state.column}

  @spec error(map(), String.t()) :: no_return()
  defp error(state, description), do: Error.raise!(state.file, meta(state), description)
end
