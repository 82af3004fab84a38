defmodule Aerie.Control.Params.Table do
  @moduledoc """
  All parameters of a vehicle at one time, and what can later show whether they have changed: PX4's `_HASH_CHECK` (`hash`, P6), or
  the checksum of ArduPilot's parameter file (`file_crc`). Both are nil if the vehicle does not have them, or if they changed while
  the list was read.
  """

  alias Aerie.Control.Params.Param

  @max 5_000

  defstruct params: %{}, order: [], hash: nil, file_crc: nil

  @type t :: %__MODULE__{
          params: %{String.t() => Param.t()},
          order: [String.t()],
          hash: non_neg_integer() | nil,
          file_crc: non_neg_integer() | nil
        }

  @doc "The longest list that is accepted; ArduPilot has about 1,400 parameters, PX4 1,100."
  @spec max() :: pos_integer()
  def max, do: @max

  @doc "A table of parameters in the order of their indices, which is also that of ArduPilot's parameter file."
  @spec new([Param.t()], keyword()) :: t()
  def new(params, more \\ []) do
    by_name = Map.new(params, &{&1.name, &1})
    struct!(%__MODULE__{params: by_name, order: Enum.map(params, & &1.name)}, more)
  end

  @doc "The number of parameters."
  @spec count(t()) :: non_neg_integer()
  def count(table), do: map_size(table.params)

  @doc "The list as NATS and REST show it."
  @spec plain(t()) :: %{count: non_neg_integer(), params: [map()]}
  def plain(table), do: %{count: count(table), params: Enum.map(sorted(table), &Param.plain/1)}

  @doc "Reads what `plain/1` gave, as JSON brings it."
  @spec parse(term()) :: {:ok, t()} | :error
  def parse(%{"params" => params}) when is_list(params) and length(params) <= @max do
    parsed = for object <- params, {:ok, param} <- [Param.parse(object)], do: param
    if length(parsed) == length(params), do: {:ok, new(parsed)}, else: :error
  end

  def parse(_other), do: :error

  @doc "All parameters in the order of their names."
  @spec sorted(t()) :: [Param.t()]
  def sorted(table), do: Enum.sort_by(Map.values(table.params), & &1.name)
end
