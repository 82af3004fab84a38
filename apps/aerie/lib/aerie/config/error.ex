defmodule Aerie.Config.Error do
  @moduledoc """
  An error in a configuration.

    * `file` - where the value came from: a file name, `environment variable AERIE_…`, `command line`
    * `path` - the key, as `nats.port` or `links[2].url`; `""` means the whole file
    * `line` - line of the file, nil if it is not known
    * `expected` - what was expected, in words
    * `got` - the value as it would be written in YAML; nil if it is secret or missing
    * `hint` - a suggestion (`did you mean "nats"?`), or nil

  `to_string/1` gives the one line that an operator sees.
  """

  @enforce_keys [:file, :path, :expected]
  defstruct [:file, :path, :line, :expected, :got, :hint]

  @type t :: %__MODULE__{
          file: String.t(),
          path: String.t(),
          line: pos_integer() | nil,
          expected: String.t(),
          got: String.t() | nil,
          hint: String.t() | nil
        }

  @doc "The error as one line: where, which key, what was expected, what was given, what may help."
  @spec format(t()) :: String.t()
  def format(%__MODULE__{} = error) do
    where = if error.line, do: "#{error.file}:#{error.line}", else: error.file
    key = if error.path == "", do: "", else: "#{error.path}: "
    got = if error.got, do: ", got #{error.got}", else: ""
    hint = if error.hint, do: " (#{error.hint})", else: ""
    "#{where}: #{key}expected #{error.expected}#{got}#{hint}"
  end

  @doc "A path in words as its segments: `links[2].url` is `[\"links\", 2, \"url\"]`."
  @spec segments(String.t()) :: [String.t() | non_neg_integer()]
  def segments(key) do
    for [_all | groups] <- Regex.scan(~r/([^.\[\]]+)|\[(\d+)\]/, key) do
      case groups do
        [name] -> name
        ["", index] -> String.to_integer(index)
      end
    end
  end

  @doc "A key's path in words: `[\"links\", 2, \"url\"]` is `links[2].url`."
  @spec path([String.t() | non_neg_integer()]) :: String.t()
  def path(segments) do
    Enum.reduce(segments, "", fn
      index, "" when is_integer(index) -> "[#{index}]"
      index, path when is_integer(index) -> "#{path}[#{index}]"
      name, "" -> printable(name)
      name, path -> "#{path}.#{printable(name)}"
    end)
  end

  defp printable(text) do
    text = Aerie.Base.Printable.line(text)
    if String.length(text) > 60, do: String.slice(text, 0, 57) <> "...", else: text
  end

  defimpl String.Chars do
    defdelegate to_string(error), to: Aerie.Config.Error, as: :format
  end
end
