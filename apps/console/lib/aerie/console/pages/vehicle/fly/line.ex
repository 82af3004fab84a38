defmodule Aerie.Console.Pages.Vehicle.Fly.Line do
  @moduledoc "The line over the map: the six values that a pilot looks at. A value that is not known says so."
  use Aerie.Console, :component

  alias Aerie.Console.Commands.Outcome
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Vehicle.Snapshot

  @typedoc "`:more` stands smaller beside the value, `:age` in microseconds."
  @type item :: %{
          name: String.t(),
          text: String.t() | nil,
          more: [String.t()],
          age: integer() | nil,
          tone: nil | :warn | :bad
        }

  attr :view, View, required: true
  attr :events, :list, required: true, doc: "of the vehicle, oldest first"

  @doc "The line."
  def line(assigns) do
    assigns = assign(assigns, :items, items(assigns.view, assigns.events))

    ~H"""
    <dl id="fly-line" class="fly-line">
      <div :for={item <- @items} :key={item.name} class={item.tone && Atom.to_string(item.tone)}>
        <dt>{item.name} <.age us={item.text && item.age} limit_us={3_000_000} /></dt>
        <dd>
          <.icon :if={item.tone} name="alert" />{item.text || "unknown"}
          <small :for={text <- item.more}>{text}</small>
        </dd>
      </div>
    </dl>
    """
  end

  @doc "The values, in the order of the line."
  @spec items(View.t(), [map()]) :: [item()]
  def items(view, events) do
    share = View.get(view, [:battery, :remaining])

    [
      item("Height", value(view, [:position, :alt_rel], 1), View.age(view, :position)),
      item("Speed", value(view, [:velocity, :groundspeed], 1), View.age(view, :velocity)),
      item("Home", home(view.vehicle), View.age(view, :position)),
      item("Battery", share && View.text(view, [:battery, :remaining]), View.age(view, :battery), %{
        more: [value(view, [:battery, :voltage], 1), left(View.get(view, [:battery, :time_remaining]))],
        tone: charge(share)
      }),
      item("Satellites", value(view, [:gps, :satellites], 0), View.age(view, :gps), %{
        more: [View.get(view, [:gps, :fix_name]) && View.text(view, [:gps, :fix_name])],
        tone: fix(View.get(view, [:gps, :fix]))
      }),
      item("Flight", flight(view, events), nil)
    ]
  end

  defp item(name, text, age, more \\ %{}) do
    more = Map.update(more, :more, [], &Enum.reject(&1, fn text -> text == nil end))
    Map.merge(%{name: name, text: text, age: age, tone: nil}, more)
  end

  defp value(view, path, decimals),
    do: if(View.get(view, path) != nil, do: View.text(view, path, %{decimals: decimals}))

  defp home(vehicle) do
    with %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) <- Snapshot.data(vehicle, :home),
         metres when metres != nil <- Snapshot.distance(vehicle, {lat, lon}),
         do: Outcome.metres(metres),
         else: (_unknown -> nil)
  end

  defp left(nil), do: nil
  defp left(seconds) when seconds < 100, do: "#{seconds} s left"
  defp left(seconds), do: "#{div(seconds, 60)} min left"

  @doc "Whether a remaining charge is low; nil where it is not, or not known."
  @spec charge(number() | nil) :: nil | :warn | :bad
  def charge(share) when is_number(share) and share < 0.15, do: :bad
  def charge(share) when is_number(share) and share < 0.3, do: :warn
  def charge(_share), do: nil

  defp fix(fix) when is_integer(fix) and fix < 2, do: :bad
  defp fix(2), do: :warn
  defp fix(_good_or_unknown), do: nil

  # What began before this gateway knew the vehicle is not known.
  defp flight(view, events) do
    case {View.get(view, [:mode, :in_air]),
          Enum.find(Enum.reverse(events), &(&1.type in ["takeoff", "landed"]))} do
      {true, %{type: "takeoff", time: at}} -> clock(div(max(view.now - at, 0), 1_000_000))
      {false, _last} -> "–"
      _unknown -> nil
    end
  end

  defp clock(seconds) when seconds < 3600, do: "#{two(div(seconds, 60))}:#{two(rem(seconds, 60))}"
  defp clock(seconds), do: "#{div(seconds, 3600)}:#{clock(rem(seconds, 3600))}"

  defp two(number), do: String.pad_leading("#{number}", 2, "0")
end
