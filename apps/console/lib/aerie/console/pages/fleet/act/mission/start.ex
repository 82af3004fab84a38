defmodule Aerie.Console.Pages.Fleet.Act.Mission.Start do
  @moduledoc """
  The missions of several vehicles, started one after the other: in which order and how long after each other. Pure. The
  first one that fails ends it: the others do not begin.
  """
  @behaviour Aerie.Console.Pages.Fleet.Act.Sheet

  alias Aerie.Console.Pages.Fleet.Act.Sheet
  alias Aerie.Vehicle.Snapshot

  @enforce_keys [:order]
  defstruct [:order, out: MapSet.new(), interval: 10, error: nil]

  @typedoc "`:interval` - s between two"
  @type t :: %__MODULE__{}

  @typedoc "What is known of a vehicle: its snapshot, and why the policy or the firmware refuses it."
  @type facts :: %{snapshot: Snapshot.t(), refusal: String.t() | nil}

  @typedoc "`:items` - of the mission aboard, nil if that is not known; `:blocks` - why nothing begins with it"
  @type line :: %{
          id: String.t(),
          n: pos_integer() | nil,
          items: non_neg_integer() | nil,
          after_s: number() | nil,
          blocks: String.t() | nil
        }

  @limits %{interval: {0, 3_600}}

  @doc "The limits of the numbers."
  @spec limits() :: Sheet.limits()
  def limits, do: @limits

  @doc "A sheet for these vehicles, by name."
  @spec new([Snapshot.t(), ...]) :: t()
  def new(vehicles), do: %__MODULE__{order: vehicles |> Enum.map(& &1.id) |> Enum.sort()}

  @impl Sheet
  def event(sheet, "change", fields) do
    {numbers, error} = Sheet.numbers(@limits, fields)
    struct!(sheet, Map.put(numbers, :error, error))
  end

  def event(sheet, "move", %{"id" => id, "to" => to}), do: Sheet.move(sheet, id, to)
  def event(sheet, "leave", %{"id" => id}), do: Sheet.leave(sheet, id)
  def event(sheet, _unknown, _value), do: sheet

  @doc "The lines in their order, with what is known of each vehicle, by id."
  @spec lines(t(), %{String.t() => facts()}) :: [line()]
  def lines(sheet, facts), do: for({id, n} <- Sheet.places(sheet), do: line(sheet, {id, n}, facts[id]))

  defp line(sheet, {id, n}, facts) do
    items = facts && Snapshot.data(facts.snapshot, :mission)[:total]

    %{
      id: id,
      n: n && n + 1,
      items: items,
      after_s: n && n * sheet.interval,
      blocks: n && blocks(id, items, facts)
    }
  end

  defp blocks(id, _items, nil), do: "#{id} is not known any more: leave it out."
  defp blocks(id, 0, _facts), do: "#{id} has no mission aboard: leave it out."
  defp blocks(id, _items, %{refusal: <<_::binary>> = why}), do: "#{id}: #{why}"

  defp blocks(id, _items, %{snapshot: snapshot}) do
    if Snapshot.data(snapshot, :mode)[:in_air] != true, do: "#{id} is not in the air: leave it out."
  end

  @impl Sheet
  def refusal(sheet, facts) do
    going = for %{n: n} = line when n != nil <- lines(sheet, facts), do: line

    cond do
      sheet.error -> sheet.error
      going == [] -> "All are left out."
      true -> Enum.find_value(going, & &1.blocks)
    end
  end

  @impl Sheet
  def shown(sheet, facts) do
    vehicles = for %{n: n} = line when n != nil <- lines(sheet, facts), do: [line.id, line.items]
    %{"start" => vehicles, "interval" => sheet.interval}
  end

  @doc "The operation that such a press asks for."
  @spec request(id :: String.t(), shown :: map()) :: map()
  def request(id, %{"start" => vehicles, "interval" => interval}) do
    %{
      "id" => id,
      "name" => "Start missions",
      "pause_s" => interval,
      "halt_ratio" => 0,
      "sequence" =>
        for(
          [vehicle, _items] <- vehicles,
          do: %{"vehicle" => vehicle, "steps" => [%{"type" => "mission_start"}]}
        )
    }
  end
end
