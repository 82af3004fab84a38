defmodule Aerie.Base.Json do
  @moduledoc """
  Converts values of the read model to values that JSON can represent. Pure.

  NaN and infinity become null. A vehicle's text may have any bytes, and becomes valid UTF-8. Anything else without a JSON form
  becomes its Elixir representation.
  """

  @doc "A value that `JSON.encode!/1` takes."
  @spec plain(term()) :: term()
  def plain(map) when is_map(map) and not is_struct(map),
    do: Map.new(map, fn {key, value} -> {name(key), plain(value)} end)

  def plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  def plain(odd) when odd in [:nan, :infinity, :neg_infinity], do: nil
  def plain({:nan, _bits}), do: nil
  def plain(text) when is_binary(text), do: text(text)
  def plain(value) when is_number(value) or is_atom(value), do: value
  def plain(other), do: inspect(other, limit: 20, printable_limit: 200)

  @doc "Text as valid UTF-8."
  @spec text(binary()) :: String.t()
  def text(text), do: if(String.valid?(text), do: text, else: String.replace_invalid(text))

  @doc "A time in unix microseconds as ISO 8601 in UTC with milliseconds; nil stays nil."
  @spec time(integer() | nil) :: String.t() | nil
  def time(nil), do: nil

  def time(us),
    do: us |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond) |> DateTime.to_iso8601()

  defp name(key) when is_atom(key) or is_binary(key) or is_integer(key), do: key
  defp name(key), do: inspect(key)
end
