defmodule Aerie.Console.Pages.Fleet.Act.TakeOff do
  @moduledoc """
  A take-off of several vehicles as it is prepared: who, in which order, how high, and when the next one begins. Pure.
  Nothing is sent before the held press, and that carries all that was shown (`shown/2`).
  """
  @behaviour Aerie.Console.Pages.Fleet.Act.Sheet

  alias Aerie.Console.Pages.Fleet.Act.Sheet
  alias Aerie.Vehicle.Snapshot

  @enforce_keys [:order]
  defstruct [:order, out: MapSet.new(), anyway: MapSet.new()] ++
              [height: 20, stacked: true, gap: 3, interval: 6, above: nil, on_fail: "hold", error: nil]

  @typedoc """
    * `:order` - the ids of all of them; `:out` - those that are left out; `:anyway` - those that take off although it
      is not known whether they are ready
    * `:height` - m above home; `:stacked` - each `:gap` m higher than the one before
    * `:interval` - s between two; `:above` - m above home that one has to reach before the next one begins, nil as
      long as nobody has changed it (`above/1`)
    * `:on_fail` - `hold`: the rest stays on the ground; `continue`: without it; `return`: all come back
  """
  @type t :: %__MODULE__{}

  @typedoc "What is known of a vehicle: its snapshot, its readiness, and why the policy or the firmware refuses it."
  @type facts :: %{snapshot: Snapshot.t(), readiness: map(), refusal: String.t() | nil}

  @typedoc "A line of the sheet. `:height` is nil for one that is left out; `:blocks`: why nothing begins with it."
  @type line :: %{
          id: String.t(),
          n: pos_integer() | nil,
          height: number() | nil,
          after_s: number() | nil,
          state: atom(),
          why: String.t() | nil,
          blocks: String.t() | nil
        }

  # Twice the room of a vehicle.
  @near_m 3.0
  @limits %{height: {1, 1_000}, gap: {0, 100}, interval: {0, 600}, above: {0.5, 100}}
  @on_fail ~w(hold continue return)

  @doc "What may happen when one fails, with words for it."
  @spec on_fail() :: [{String.t(), String.t()}]
  def on_fail,
    do: [
      {"hold", "Hold the rest on the ground"},
      {"continue", "Continue without it"},
      {"return", "Bring all back"}
    ]

  @doc "The limits of the numbers."
  @spec limits() :: %{atom() => {number(), number()}}
  def limits, do: @limits

  @doc "A sheet for these vehicles, from south to north."
  @spec new([Snapshot.t(), ...]) :: t()
  def new(vehicles) do
    order = Enum.sort_by(vehicles, &{Snapshot.data(&1, :position)[:lat] || 90, &1.id})
    %__MODULE__{order: Enum.map(order, & &1.id)}
  end

  @doc "After the fields were changed. A number beyond its limits, or another text, changes nothing and is said."
  @spec change(t(), map()) :: t()
  def change(sheet, fields) do
    {numbers, error} = Sheet.numbers(@limits, fields)
    # A form has all its fields.
    numbers = if numbers[:above] == above(sheet), do: Map.delete(numbers, :above), else: numbers
    on_fail = if fields["on_fail"] in @on_fail, do: fields["on_fail"], else: sheet.on_fail
    stacked = if fields["stacked"] in ["true", "false"], do: fields["stacked"] == "true", else: sheet.stacked
    struct!(sheet, Map.merge(numbers, %{on_fail: on_fail, stacked: stacked, error: error}))
  end

  @doc "The height above which the next one begins: 5 m, or half of a height below 10 m, if it was not changed."
  @spec above(t()) :: number()
  def above(%{above: nil, height: height}), do: min(5, max(trunc(height / 2), 0.5))
  def above(%{above: above}), do: above

  @doc "Why the next one would never begin; nil if it does."
  @spec futile(t()) :: String.t() | nil
  def futile(%{height: height} = sheet) do
    if above(sheet) >= height,
      do: "The lowest flies at #{height} m and is never above #{above(sheet)} m: give less than #{height} m."
  end

  @impl Sheet
  def event(sheet, "change", fields), do: change(sheet, fields)
  def event(sheet, "move", %{"id" => id, "to" => to}), do: Sheet.move(sheet, id, to)
  def event(sheet, "anyway", %{"id" => id}), do: anyway(sheet, id)

  def event(sheet, "leave", %{"id" => id}),
    do: Sheet.leave(%{sheet | anyway: MapSet.delete(sheet.anyway, id)}, id)

  def event(sheet, _unknown, _value), do: sheet

  @doc "Takes a vehicle along although it is not known whether it is ready."
  @spec anyway(t(), String.t()) :: t()
  def anyway(sheet, id),
    do: if(id in sheet.order, do: %{sheet | anyway: MapSet.put(sheet.anyway, id)}, else: sheet)

  @doc "The lines in their order, with what is known of each vehicle, by id."
  @spec lines(t(), %{String.t() => facts()}) :: [line()]
  def lines(sheet, facts), do: for({id, n} <- Sheet.places(sheet), do: line(sheet, id, n, facts[id]))

  defp line(sheet, id, n, facts) do
    readiness = (facts && facts.readiness) || %{state: :unknown, points: []}
    why = worst(readiness) || (facts && facts.refusal)

    %{
      id: id,
      n: n && n + 1,
      height: n && height(sheet, n),
      after_s: n && n * sheet.interval,
      state: readiness.state,
      why: why,
      blocks: n && blocks(sheet, id, readiness.state, facts)
    }
  end

  defp height(%{stacked: true} = sheet, n), do: sheet.height + n * sheet.gap
  defp height(sheet, _n), do: sheet.height

  defp worst(%{state: state, points: points}) when state != :ready,
    do: with(%{title: title, text: text} <- Enum.find(points, &(&1.state == state)), do: "#{title}: #{text}")

  defp worst(_ready), do: nil

  defp blocks(_sheet, id, _state, nil), do: "#{id} is not known any more: leave it out."
  defp blocks(_sheet, id, :not_ready, _facts), do: "#{id} is not ready: leave it out."
  defp blocks(_sheet, id, _state, %{refusal: <<_::binary>> = why}), do: "#{id}: #{why}"

  defp blocks(sheet, id, :unknown, _facts) do
    if not MapSet.member?(sheet.anyway, id),
      do: "It is not known whether #{id} is ready: leave it out, or take it along anyway."
  end

  defp blocks(_sheet, _id, _ready, _facts), do: nil

  @doc "The two nearest to each other of those that take off, with the metres between them; nil without two places."
  @spec nearest([line()], %{String.t() => facts()}) :: {String.t(), String.t(), float()} | nil
  def nearest(lines, facts) do
    seen = for %{n: n, id: id} when n != nil <- lines, %{snapshot: snapshot} <- [facts[id]], do: snapshot

    for {one, i} <- Enum.with_index(seen),
        other <- Enum.drop(seen, i + 1),
        metres = Snapshot.distance(one, Sheet.place(other)),
        reduce: nil do
      {_one, _other, least} = nearest when least <= metres -> nearest
      _farther -> {one.id, other.id, metres}
    end
  end

  @impl Sheet
  def refusal(sheet, facts) do
    lines = lines(sheet, facts)
    going = Enum.filter(lines, & &1.n)
    nearest = nearest(lines, facts)

    cond do
      sheet.error -> sheet.error
      futile = futile(sheet) -> futile
      going == [] -> "All are left out."
      blocked = Enum.find_value(going, & &1.blocks) -> blocked
      match?({_one, _other, m} when m < @near_m, nearest) -> near(nearest)
      true -> nil
    end
  end

  defp near({one, other, metres}),
    do:
      "#{one} and #{other} stand #{Float.round(metres, 1)} m apart; #{@near_m} m are wanted. Leave one of them out."

  @impl Sheet
  def shown(sheet, facts) do
    vehicles =
      for %{n: n} = line when n != nil <- lines(sheet, facts),
          do: [line.id, line.height, Atom.to_string(line.state), MapSet.member?(sheet.anyway, line.id)]

    %{
      "vehicles" => vehicles,
      "interval" => sheet.interval,
      "above" => above(sheet),
      "on_fail" => sheet.on_fail
    }
  end

  @doc "The operation that such a press asks for. `steps` gives a vehicle's part of it (`Aerie.Fleet.take_off/4`)."
  @spec request(id :: String.t(), shown :: map(), (id :: String.t(), number(), number(), boolean() -> map())) ::
          map()
  def request(id, shown, steps) do
    plan =
      case shown["on_fail"] do
        "hold" -> %{"halt_ratio" => 0}
        "continue" -> %{"halt_ratio" => 1}
        "return" -> %{"halt_ratio" => 0, "on_halt" => "return"}
      end

    Map.merge(plan, %{
      "id" => id,
      "name" => "Take off",
      "pause_s" => shown["interval"],
      "sequence" =>
        for(
          [vehicle, height, _word, anyway?] <- shown["vehicles"],
          do: steps.(vehicle, height, shown["above"], anyway?)
        ),
      "shown" => for([vehicle, _height, word, _anyway] <- shown["vehicles"], into: %{}, do: {vehicle, word})
    })
  end
end
