defmodule SimVehicle.Params do
  @moduledoc """
  The parameter table of a vehicle: read by name or index, set, and coded as the firmware codes it (rule P2).

  Integers are stored as integers, the others as 32-bit floats. On the wire ArduPilot casts (`:c_cast`: 5 -> 5.0) and
  PX4 copies the bytes (`:bytewise`: 5 -> 7.0e-45).
  """

  alias MavCodec.CRC
  alias Protocols.Params.Listing
  alias SimVehicle.Real32

  @real32 9

  @integer_ranges %{
    1 => {0, 255},
    2 => {-128, 127},
    3 => {0, 65_535},
    4 => {-32_768, 32_767},
    5 => {0, 4_294_967_295},
    6 => {-2_147_483_648, 2_147_483_647}
  }

  defstruct [:listing, values: %{}]

  @typedoc "`values`: name => {value, MAV_PARAM_TYPE}; `listing`: the names by index."
  @type t :: %__MODULE__{}
  @type definition :: {String.t(), number, 1..9}

  @doc "A table in the order given; the index of a parameter is its place."
  @spec new([definition], :c_cast | :bytewise) :: t
  def new(definitions, encoding) do
    names = Enum.map(definitions, &elem(&1, 0))

    %__MODULE__{
      listing: Listing.new(names, encoding),
      values: Map.new(definitions, fn {name, value, type} -> {name, {store(value, type), type}} end)
    }
  end

  @doc "The table with more parameters at its end."
  @spec append(t, [definition]) :: t
  def append(params, []), do: params

  def append(params, definitions) do
    old = for name <- names(params), {value, type} = params.values[name], do: {name, value, type}
    new(old ++ definitions, params.listing.encoding)
  end

  @doc "The value of a parameter that is known to exist."
  @spec get(t, String.t()) :: number
  def get(params, name), do: params.values |> Map.fetch!(name) |> elem(0)

  @doc "True when the table has this parameter."
  @spec member?(t, String.t()) :: boolean
  def member?(params, name), do: is_map_key(params.values, name)

  @doc "PARAM_VALUE of a parameter; for PX4 also of `_HASH_CHECK`."
  @spec message(t, String.t()) :: struct
  def message(%{listing: %{encoding: :bytewise} = listing} = params, "_HASH_CHECK"),
    do: Listing.hash(listing, hash(params))

  def message(params, name) do
    {value, type} = Map.fetch!(params.values, name)
    Listing.value(params.listing, name, value, type)
  end

  @doc "Stores a plain number, cut to the range of the parameter's type; used by tests and options."
  @spec put(t, String.t(), number) :: {:ok, t} | {:error, :unknown}
  def put(params, name, value) do
    case params.values do
      %{^name => {_old, type}} -> {:ok, write(params, name, store(value, type), type)}
      _unknown -> {:error, :unknown}
    end
  end

  @doc """
  Stores what a PARAM_SET carried. PX4 (bytewise) refuses a type that is not the parameter's; ArduPilot ignores the
  type (rule P7). A value that is not a number is refused.
  """
  @spec set(t, String.t(), Real32.value(), integer) :: {:ok, t} | {:error, :unknown | :type | :value}
  def set(params, name, wire, wire_type) do
    case params.values do
      %{^name => {_old, type}} -> accept(params, name, wire, wire_type, type)
      _unknown -> {:error, :unknown}
    end
  end

  @doc "PX4's `_HASH_CHECK`: MAVLink's CRC-32 over all names and values in the order of the list (rule P6)."
  @spec hash(t) :: non_neg_integer
  def hash(params) do
    data =
      for name <- names(params) do
        {value, type} = Map.fetch!(params.values, name)
        [name, if(type == @real32, do: <<value::float-little-32>>, else: <<value::little-signed-32>>)]
      end

    CRC.crc32(data)
  end

  @doc "The table for ArduPilot's parameter file. Every value is its own default but odd ones, which have one of 0."
  @spec packed(t) :: [MavCodec.Ftp.PackedParams.param()]
  def packed(params) do
    for name <- names(params) do
      {value, type} = Map.fetch!(params.values, name)
      {name, type, value, if(is_integer(value) and rem(value, 2) == 1, do: 0)}
    end
  end

  defp accept(%{listing: %{encoding: :bytewise}}, _name, _wire, wire_type, type) when wire_type != type,
    do: {:error, :type}

  defp accept(%{listing: %{encoding: :bytewise}} = params, name, wire, _wire_type, type)
       when type != @real32 do
    <<value::signed-32>> = <<Real32.to_bits(wire)::32>>
    {:ok, write(params, name, value, type)}
  end

  defp accept(params, name, wire, _wire_type, type) when is_number(wire),
    do: {:ok, write(params, name, store(wire, type), type)}

  defp accept(_params, _name, _wire, _wire_type, _type), do: {:error, :value}

  defp write(params, name, value, type), do: %{params | values: Map.put(params.values, name, {value, type})}

  defp names(params), do: Tuple.to_list(params.listing.names)

  defp store(value, @real32), do: Real32.round32(value * 1.0)

  defp store(value, type) do
    {lowest, highest} = Map.fetch!(@integer_ranges, type)
    value |> round() |> max(lowest) |> min(highest)
  end
end
