defmodule MavCodec.Meaning.Commands do
  @moduledoc """
  The table of all MAV_CMDs of the definitions: what each of them needs, as a command and as an item of a mission. A
  command without a row is refused (`policy.unknown`); a test compares the table with the definitions.

  The rows are in `MavCodec.Meaning.Commands.Flight`, `Payload` and `Upkeep`, by what they are about.
  """

  alias MavCodec.Meaning.Commands.Flight
  alias MavCodec.Meaning.Commands.Numbers
  alias MavCodec.Meaning.Commands.Payload
  alias MavCodec.Meaning.Commands.Row
  alias MavCodec.Meaning.Commands.Upkeep
  alias MavCodec.Enums.MavCmd

  row = fn {name, permission, options} ->
    id = MavCmd.value(:"MAV_CMD_#{name}") || raise("the definitions have no command #{name}")
    place = Keyword.get(options, :place, :none)

    %Row{
      id: id,
      name: Atom.to_string(name),
      class: Keyword.get(options, :class, :command),
      permission: permission,
      as_command: Keyword.get(options, :as_command, place),
      as_item: Keyword.get(options, :as_item, place),
      numbers: Numbers.of(id, Keyword.get(options, :numbers, []))
    }
  end

  @rows Enum.map(Flight.rows() ++ Payload.rows() ++ Upkeep.rows(), row)
  @by_id Map.new(@rows, &{&1.id, &1})

  if map_size(@by_id) != length(@rows), do: raise("a command has two rows")

  @doc "All rows, by id."
  @spec all() :: [Row.t(), ...]
  def all, do: Enum.sort_by(@rows, & &1.id)

  @doc "The row of a command, nil if it has none."
  @spec get(integer()) :: Row.t() | nil
  def get(id), do: Map.get(@by_id, id)

  @doc "Whether a command only asks for something. One without a row does not."
  @spec question?(integer()) :: boolean()
  def question?(id), do: match?(%{^id => %{class: :question}}, @by_id)

  @doc "The least that a command needs (`t:Row.permission/0`), nil if it has no row."
  @spec permission(integer()) :: Row.permission() | nil
  def permission(id), do: with(%{permission: permission} <- get(id), do: permission)

  @doc "Whether a mission item of this command is a place to which the vehicle flies."
  @spec place?(integer()) :: boolean()
  def place?(id), do: match?(%{^id => %{as_item: :flown}}, @by_id)

  @doc """
  Whether the parameters, by their number, are as a firmware can read them in one way only: the first that is not, in
  words. An infinite number is refused in any place.
  """
  @spec check(Row.t(), %{(1..7) => term()}) :: :ok | {:error, String.t()}
  def check(row, params) do
    wrong =
      Enum.find_value(row.numbers, fn {index, kind} ->
        value = params[index]
        if Numbers.read(value, kind) == :error, do: {index, value, Numbers.text(kind)}
      end)

    case wrong || Enum.find_value(params, &infinite/1) do
      nil -> :ok
      {index, value, expected} -> {:error, "parameter #{index} is #{format(value)}, not #{expected}"}
    end
  end

  defp infinite({index, value}) when value in [:infinity, :neg_infinity], do: {index, value, "a number"}
  defp infinite(_finite), do: nil

  defp format(:infinity), do: "infinite"
  defp format(:neg_infinity), do: "infinite"
  defp format(value), do: "#{value}"
end
