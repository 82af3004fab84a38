defmodule Phoenix.LiveView.Query do
  @moduledoc """
  URL-encoded forms and queries as nested maps: `a[b]=1&c[]=2` is `%{"a" => %{"b" => "1"}, "c" => ["2"]}`. Total and bounded: input that
  is not valid UTF-8, too deep or too long is an error, and nothing becomes an atom.
  """

  @max_pairs 2_000
  @max_depth 12

  @doc "The parameters of a query."
  @spec decode(String.t()) :: {:ok, map()} | {:error, String.t()}
  def decode(query) do
    pairs = query |> String.split("&", trim: true, parts: @max_pairs + 1)

    if length(pairs) > @max_pairs,
      do: {:error, "more than #{@max_pairs} parameters"},
      else: Enum.reduce_while(pairs, {:ok, %{}}, &pair/2)
  end

  defp pair(pair, {:ok, params}) do
    {name, value} =
      case String.split(pair, "=", parts: 2) do
        [name, value] -> {name, value}
        [name] -> {name, ""}
      end

    with {:ok, name} <- unescape(name),
         {:ok, value} <- unescape(value),
         path when length(path) <= @max_depth <- path(name) do
      {:cont, {:ok, put(params, path, value)}}
    else
      :error -> {:halt, {:error, "a parameter is not valid text"}}
      _deep -> {:halt, {:error, "a parameter has more than #{@max_depth} levels"}}
    end
  end

  defp unescape(text) do
    text = URI.decode_www_form(text)
    if String.valid?(text), do: {:ok, text}, else: :error
  rescue
    # Malformed percent encoding.
    ArgumentError -> :error
  end

  @doc ~S|The path of a name: `"a[b][]"` is `["a", "b", ""]`.|
  @spec path(String.t()) :: [String.t()]
  def path(name) do
    case String.split(name, "[", parts: 2) do
      [name] -> [name]
      [head, rest] -> [head | rest |> String.trim_trailing("]") |> String.split("][")]
    end
  end

  defp put(params, [name], value) when is_map(params), do: Map.put(params, name, value)

  defp put(params, [name, ""], value) when is_map(params) do
    Map.update(params, name, [value], fn
      list when is_list(list) -> list ++ [value]
      _other -> [value]
    end)
  end

  defp put(params, [name | path], value) when is_map(params) do
    inner = if is_map(params[name]), do: params[name], else: %{}
    Map.put(params, name, put(inner, path, value))
  end
end
