defmodule Protocols.Params.Listing do
  @moduledoc """
  The parameters of a vehicle by their indices, and the messages by which it, or the gateway in its place, says their
  values (P2, P4). The values themselves are their owner's.
  """

  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M

  # PX4's parameter that is not in the list (P6), with the MAV_PARAM_TYPE UINT32.
  @hash "_HASH_CHECK"
  @uint32 5
  @no_index 65_535

  @enforce_keys [:encoding]
  defstruct [:encoding, names: {}, indices: %{}]

  @type t :: %__MODULE__{
          encoding: ParamValue.encoding(),
          names: tuple(),
          indices: %{String.t() => non_neg_integer()}
        }

  @doc "A list of names in the order of their indices."
  @spec new([String.t()], ParamValue.encoding()) :: t()
  def new(names, encoding),
    do: %__MODULE__{
      encoding: encoding,
      names: List.to_tuple(names),
      indices: names |> Enum.with_index() |> Map.new()
    }

  @doc "How many there are."
  @spec count(t()) :: non_neg_integer()
  def count(listing), do: tuple_size(listing.names)

  @doc "The name that PARAM_REQUEST_READ asks for, by itself or by its index; nil for one that is not in the list."
  @spec wanted(t(), struct()) :: String.t() | nil
  def wanted(listing, %{param_index: -1, param_id: name}),
    do: if(is_map_key(listing.indices, name), do: name)

  def wanted(listing, %{param_index: index}), do: at(listing, index)

  @doc "The name with an index, nil for none."
  @spec at(t(), integer()) :: String.t() | nil
  def at(%{names: names}, index) when index >= 0 and index < tuple_size(names), do: elem(names, index)
  def at(_listing, _index), do: nil

  @doc "PARAM_VALUE. A value that loses bits in a float loses them as when the vehicle sends it."
  @spec value(t(), String.t(), number(), type :: 1..10) :: struct()
  def value(listing, name, value, type) do
    %M.ParamValue{
      param_id: name,
      param_value: wire(value, type, listing.encoding),
      param_type: type,
      param_count: count(listing),
      param_index: Map.get(listing.indices, name, @no_index)
    }
  end

  @doc "PARAM_VALUE of PX4's checksum of its parameters."
  @spec hash(t(), non_neg_integer()) :: struct()
  def hash(listing, crc), do: value(listing, @hash, crc, @uint32)

  @doc "The name of PX4's checksum."
  @spec hash() :: String.t()
  def hash, do: @hash

  defp wire(value, type, encoding) do
    case ParamValue.encode(value, type, encoding) do
      {:ok, wire} -> wire
      {:error, _inexact} -> ParamValue.float32(value)
    end
  end
end
