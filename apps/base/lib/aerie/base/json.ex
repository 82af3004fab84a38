defmodule Aerie.Base.Json do
  @moduledoc """
  Converts values of the read model to values that JSON can represent, and encodes what people and programs read. Pure.

  NaN and infinity become null. A vehicle's text may have any bytes, and becomes valid UTF-8. Anything else without a
  JSON form becomes its Elixir representation.
  """

  # Items of a list or an object.
  @max_shown 5
  # Times between 1970 and 9999.
  @first_day :calendar.date_to_gregorian_days(1970, 1, 1)
  @last_us 253_402_300_799_999_999
  @two List.to_tuple(for n <- 0..99, do: String.pad_leading("#{n}", 2, "0"))

  @doc "A value that `JSON.encode!/1` takes."
  @spec plain(term()) :: term()
  def plain(map) when is_non_struct_map(map), do: plain(map, fn _key, value -> plain(value) end)
  def plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  def plain(odd) when odd in [:nan, :infinity, :neg_infinity], do: nil
  def plain({:nan, _bits}), do: nil
  def plain(text) when is_binary(text), do: text(text)
  def plain(value) when is_number(value) or is_atom(value), do: value
  def plain(other), do: inspect(other, limit: 20, printable_limit: 200)

  @doc "An object whose values a function makes plain, which is given the key as well."
  @spec plain(map(), (term(), term() -> term())) :: map()
  def plain(map, value),
    do: :maps.from_list(for {key, one} <- Map.to_list(map), do: {name(key), value.(key, one)})

  @doc "JSON with numbers as people write them: 1000.0, where `JSON.encode!/1` has 1.0e3."
  @spec encode!(term()) :: String.t()
  def encode!(value), do: JSON.encode!(value, &encode/2)

  @doc "As `encode!/1`."
  @spec encode_to_iodata!(term()) :: iodata()
  def encode_to_iodata!(value), do: JSON.encode_to_iodata!(value, &encode/2)

  @doc "The encoder of `encode!/1`, for one that has more to say. Protocols are asked only for what is rare."
  @spec encode(term(), (term(), term() -> iodata())) :: iodata()
  def encode(number, _encoder) when is_float(number), do: decimal(number)
  def encode(number, _encoder) when is_integer(number), do: Integer.to_string(number)
  def encode(nil, _encoder), do: "null"
  def encode(text, _encoder) when is_binary(text), do: :json.encode_binary(text)
  def encode(map, _encoder) when map == %{}, do: "{}"

  def encode(map, encoder) when is_non_struct_map(map) do
    [[_comma | first] | rest] =
      for {key, value} <- Map.to_list(map), do: [?,, key(key), ?: | encoder.(value, encoder)]

    [?{, first, rest, ?}]
  end

  def encode(value, encoder), do: JSON.protocol_encode(value, encoder)

  # Atoms are names in the code: there is nothing to escape.
  defp key(key) when is_atom(key), do: [?", Atom.to_string(key), ?"]
  defp key(key), do: key |> to_string() |> :json.encode_binary()

  # What is read as the same number again. Numbers beyond all units keep their exponent.
  defp decimal(number) do
    short = :erlang.float_to_binary(number, [:short])

    with [digits, exponent] <- :binary.split(short, "e"),
         exponent when exponent in -7..17 <- String.to_integer(exponent),
         [_whole, fraction] = :binary.split(digits, ".") do
      places = if fraction == "0", do: 0, else: byte_size(fraction)
      :erlang.float_to_binary(number, decimals: max(places - exponent, 1))
    else
      _plain -> short
    end
  end

  @doc "A number for people: without a fraction that says nothing."
  @spec number(number()) :: String.t()
  def number(n) when is_integer(n), do: Integer.to_string(n)
  def number(n) when trunc(n) == n, do: n |> trunc() |> Integer.to_string()
  def number(n), do: :erlang.float_to_binary(n, [:short])

  @doc "A value from outside as an error shows it: as JSON, `max` characters at most."
  @spec shown(term(), pos_integer()) :: String.t()
  def shown(value, max) do
    text = show(value, max)
    if String.length(text) > max, do: String.slice(text, 0, max) <> "…", else: text
  end

  defp show(nil, _max), do: "null"
  defp show(text, max) when is_binary(text), do: inspect(text, printable_limit: max)
  defp show(number, _max) when is_float(number), do: decimal(number)
  defp show(name, _max) when is_atom(name), do: Atom.to_string(name)
  defp show(list, max) when is_list(list), do: "[#{items(list, &show(&1, max))}]"

  defp show(map, max) when is_map(map) and not is_struct(map),
    do: "{#{items(map, fn {key, value} -> "#{show(key, max)}: #{show(value, max)}" end)}}"

  defp show(other, max), do: inspect(other, limit: @max_shown, printable_limit: max)

  defp items(values, show) do
    more = if Enum.count_until(values, @max_shown + 1) > @max_shown, do: ", …", else: ""
    (values |> Enum.take(@max_shown) |> Enum.map_join(", ", show)) <> more
  end

  @doc "A text of JSON as one line: keys in order, so that equal values are equal bytes, and what is not seen escaped."
  @spec line(json :: String.t()) :: String.t()
  def line(json),
    do: json |> JSON.decode!() |> JSON.encode!(&in_order/2) |> Aerie.Base.Printable.lines()

  defp in_order(map, encoder) when is_map(map) do
    members = for {key, value} <- Enum.sort(map), do: [JSON.encode!(key), ?:, encoder.(value, encoder)]
    [?{, Enum.intersperse(members, ?,), ?}]
  end

  defp in_order(other, encoder), do: encode(other, encoder)

  @doc "Text as valid UTF-8."
  @spec text(binary()) :: String.t()
  def text(text), do: if(String.valid?(text), do: text, else: String.replace_invalid(text))

  @doc """
  Whether a value from outside is a printable text of `min` to `max` characters. They are counted as JSON Schema counts
  them, as code points: of bytes a schema cannot say how many there may be.
  """
  @spec text?(term(), non_neg_integer(), pos_integer()) :: boolean()
  def text?(text, min, max) when is_binary(text) and byte_size(text) <= 4 * max,
    do: String.printable?(text) and length(String.codepoints(text)) in min..max

  def text?(_other, _min, _max), do: false

  @doc "A time in unix microseconds as ISO 8601 in UTC with milliseconds; nil stays nil."
  @spec time(integer() | nil) :: String.t() | nil
  def time(nil), do: nil

  # Each sample that is published has one, and the calendar takes six times as long.
  def time(us) when us in 0..@last_us do
    ms = div(us, 1_000)
    {year, month, day} = :calendar.gregorian_days_to_date(@first_day + div(ms, 86_400_000))
    s = rem(div(ms, 1_000), 86_400)
    fraction = Integer.to_string(1_000 + rem(ms, 1_000))

    <<two(div(year, 100))::2-bytes, two(rem(year, 100))::2-bytes, ?-, two(month)::2-bytes, ?-,
      two(day)::2-bytes, ?T, two(div(s, 3_600))::2-bytes, ?:, two(div(rem(s, 3_600), 60))::2-bytes, ?:,
      two(rem(s, 60))::2-bytes, ?., binary_part(fraction, 1, 3)::3-bytes, ?Z>>
  end

  def time(us),
    do: us |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond) |> DateTime.to_iso8601()

  defp two(n), do: elem(@two, n)

  defp name(key) when is_atom(key) or is_binary(key) or is_integer(key), do: key
  defp name(key), do: inspect(key)
end
