defmodule Aerie.Config.Yaml.Lines do
  @moduledoc """
  The lines of the keys of a YAML text. The parser gives keys in the order of the text but no lines, so they are matched by
  their order: the third `id` of the document is the third `id:` of the text that is neither in a comment nor in quotes. Where the
  counts differ (a key inside of a block of text) a key has no line, never a wrong one.

  A path is that of `t:Aerie.Base.Settings.Schema.path/0`; the second occurrence of a key that stands twice is below `:again`.
  """

  @type t :: %{optional([String.t() | non_neg_integer() | :again]) => pos_integer()}

  @key ~r/(?:^|[\s{,\[])(?:"([^"]*)"|'([^']*)'|([\w.<][\w.\/()<-]*))\s*:(?=\s|$)/u
  @quoted ~r/("(?:[^"\\]|\\.)*"|'[^']*')(\s*:(?=\s|$))?/
  @comment ~r/(?:^|\s)#.*$/u

  @doc "The lines of a document, as `:fast_yaml` gives it, in its text."
  @spec of(term(), binary()) :: t()
  def of(document, text) do
    found = text |> String.split("\n") |> Enum.with_index(1) |> Enum.flat_map(&in_line/1)
    lines = Enum.group_by(found, &elem(&1, 0), &elem(&1, 1))
    paths = document |> paths([]) |> Enum.group_by(&key/1)

    for {key, paths} <- paths,
        there = Map.get(lines, key, []),
        length(there) == length(paths),
        {path, line} <- Enum.zip(paths, there),
        reduce: %{} do
      # The line of an item is that of its first key.
      known -> known |> Map.put(path, line) |> item(path, line)
    end
  end

  @doc "The line of a path, or of what it is in; nil if neither is known."
  @spec at(t(), [String.t() | non_neg_integer()]) :: pos_integer() | nil
  def at(_lines, []), do: nil
  def at(lines, path), do: lines[path] || at(lines, Enum.drop(path, -1))

  defp item(known, path, line) do
    case Enum.split(path, -1) do
      {above, _key} when above != [] ->
        if is_integer(List.last(above)), do: Map.update(known, above, line, &min(&1, line)), else: known

      _top ->
        known
    end
  end

  defp in_line({line, number}) do
    # A text in quotes is a value, unless a colon follows.
    plain = Regex.replace(@quoted, line, fn all, _text, colon -> if colon == "", do: "\"\"", else: all end)
    plain = String.replace(plain, @comment, "")
    for [_all | groups] <- Regex.scan(@key, plain), do: {List.last(groups), number}
  end

  defp key(path), do: path |> List.delete(:again) |> List.last()

  # In the order of the text.
  defp paths([{_, _} | _] = pairs, above) do
    {paths, _seen} =
      Enum.flat_map_reduce(pairs, MapSet.new(), fn {key, value}, seen ->
        path = [text(key) | above]
        here = if path in seen, do: [:again | path], else: path
        {[Enum.reverse(here) | paths(value, path)], MapSet.put(seen, path)}
      end)

    paths
  end

  defp paths(list, above) when is_list(list) do
    for {item, index} <- Enum.with_index(list), path <- paths(item, [index | above]), do: path
  end

  defp paths(_scalar, _above), do: []

  defp text(key) when is_binary(key), do: key
  defp text(key) when is_number(key) or is_boolean(key), do: to_string(key)
  defp text(_other), do: ""
end
