defmodule Aerie.Fleet.Inspector.Fields do
  @moduledoc """
  A frame for people: its fields with units, names of enums and flags, and its bytes. Pure.
  """

  alias MavCodec.Dialects.All
  alias MavCodec.{Frame, Message}

  # Units that nobody reads: how to make others of them.
  @scales %{
    "degE7" => {1.0e-7, 7, "°"},
    "cdeg" => {0.01, 2, "°"},
    "rad" => {180 / :math.pi(), 2, "°"},
    "rad/s" => {180 / :math.pi(), 2, "°/s"},
    "mm" => {0.001, 3, "m"},
    "cm" => {0.01, 2, "m"},
    "cm/s" => {0.01, 2, "m/s"},
    "mV" => {0.001, 3, "V"},
    "cA" => {0.01, 2, "A"},
    "d%" => {0.1, 1, "%"},
    "c%" => {0.01, 2, "%"},
    "cdegC" => {0.01, 2, "°C"},
    "ms" => {0.001, 3, "s"},
    "us" => {0.000001, 3, "s"}
  }
  @max_elements 64

  @typedoc """
  `value` as text; `means`: the name of an enum's value, the flags that are set, or the value in a usual unit, nil for neither.
  """
  @type field :: %{
          name: String.t(),
          type: String.t(),
          value: String.t(),
          units: String.t() | nil,
          means: String.t() | nil
        }

  @doc "The name of a message id, `\"#300\"` for an unknown one."
  @spec name(non_neg_integer) :: String.t()
  def name(id) do
    case All.name(id) do
      nil -> "##{id}"
      name -> name
    end
  end

  @doc "The fields in the order of the definition; nil for an unknown message."
  @spec of(Frame.t()) :: [field] | nil
  def of(%Frame{} = frame) do
    case MavCodec.decode(frame) do
      {:ok, %module{} = message} -> Enum.map(module.fields(), &field(&1, message))
      {:error, _unknown} -> nil
    end
  end

  defp field(%Message.Field{} = field, message) do
    value = Map.fetch!(message, field.key)

    %{
      name: field.name,
      type: if(field.length, do: "#{field.type}[#{field.length}]", else: "#{field.type}"),
      value: text(value, field),
      units: field.units,
      means: means(value, field)
    }
  end

  defp text(value, %{type: :char}), do: String.replace_invalid(value)
  defp text(value, %{type: :uint8, length: n}) when n != nil and is_binary(value), do: hex(value)

  defp text(values, _field) when is_list(values) do
    more = if length(values) > @max_elements, do: " …", else: ""
    (values |> Enum.take(@max_elements) |> Enum.map_join(" ", &number/1)) <> more
  end

  defp text(value, _field), do: number(value)

  defp number(value) when is_float(value), do: short(value)
  defp number(value) when is_integer(value), do: Integer.to_string(value)
  defp number(:nan), do: "NaN"
  defp number(:infinity), do: "∞"
  defp number(:neg_infinity), do: "-∞"
  defp number({:nan, _bits}), do: "NaN"

  # A float of 32 bits has seven digits, whatever a double makes of it.
  defp short(value) when value == 0, do: "0"

  defp short(value) do
    digits = :erlang.float_to_binary(value, [:short])

    if byte_size(digits) <= 10,
      do: digits,
      else: :erlang.float_to_binary(value, [{:scientific, 7}]) |> plain(value)
  end

  defp plain(scientific, value) do
    if abs(value) >= 1.0e-3 and abs(value) < 1.0e9,
      do: :erlang.float_to_binary(value, [:compact, decimals: decimals(abs(value))]),
      else: scientific
  end

  defp decimals(value), do: max(6 - trunc(:math.log10(max(value, 1.0e-3))), 0)

  defp means(value, %{enum: enum, bitmask: true}) when enum != nil and is_integer(value) do
    {flags, unknown} = enum.flags(value)

    names =
      Enum.map(flags, &label(enum, enum.value(&1), &1)) ++
        if(unknown == 0, do: [], else: ["0x" <> Integer.to_string(unknown, 16)])

    if names == [], do: "none", else: Enum.join(names, " | ")
  end

  defp means(value, %{enum: enum}) when enum != nil and is_integer(value), do: enum.label(value) || "no name"

  defp means(value, %{units: units}) when is_number(value) and is_map_key(@scales, units) do
    {factor, decimals, unit} = Map.fetch!(@scales, units)
    "#{:erlang.float_to_binary(value * factor, decimals: decimals)} #{unit}"
  end

  defp means(_value, _field), do: nil

  defp label(enum, value, name), do: enum.label(value) || Atom.to_string(name)

  @doc "Bytes in hexadecimal, two digits each, with spaces."
  @spec hex(binary) :: String.t()
  def hex(bytes), do: for(<<byte <- bytes>>, do: Base.encode16(<<byte>>)) |> Enum.join(" ")
end
