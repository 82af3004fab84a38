defmodule Aerie.Console.Pages.Fleet.Board.Row do
  @moduledoc """
  A vehicle as a row of the table. Pure. Numbers are rounded as they are shown, so that changes that are not visible are not sent.
  """

  alias Aerie.Base.Store
  alias Aerie.Console.Pages.Fleet.Board.Problems
  alias Aerie.Console.Map.Payload
  alias Aerie.Vehicle.{Firmware, Snapshot}

  @digits for digit <- ?0..?9, do: <<digit>>

  @enforce_keys [:id, :network, :system_id, :kind, :autopilot, :status, :state]
  defstruct [
    :id,
    :network,
    :system_id,
    :kind,
    :autopilot,
    :firmware,
    :status,
    :state,
    :mode,
    :armed,
    :in_air,
    :battery,
    :voltage,
    :fix,
    :satellites,
    :height,
    :speed,
    :link,
    :silent_us,
    :via,
    :order,
    :on_map,
    :home,
    :mission,
    :line,
    :readiness,
    open: [],
    problems: [],
    holder: nil,
    tags: []
  ]

  @typedoc """
    * `:state` - as on the map
    * `:battery` - 0..1; `:voltage` - V; `:height` - m above home; `:speed` - m/s over the ground
    * `:link` - 0..100, the best of its links, nil if none was measured
    * `:silent_us` - time since it was heard, in whole seconds
    * `:via` - the gateway by which it is reached, nil for a link of this one
    * `:order` - the id's place among ids, where VID-9 comes before VID-10
    * `:on_map` - the row of `Aerie.Console.Map.Payload`; `:home` - its position there; both nil where not known
    * `:mission` - how many items it has (`:total`), and the number of the one that is flown to, counted from 1 (`:current`)
    * `:line` - the rendered row (`Aerie.Console.Pages.Fleet.Board`)
    * `:readiness` - whether it is ready to take off, and in `:open` what is not, in words; nil while it is armed
    * `:holder` - who is in charge; nil for nobody
    * `:tags` - sorted
  """
  @type t :: %__MODULE__{
          id: String.t(),
          network: String.t(),
          system_id: non_neg_integer(),
          kind: String.t(),
          autopilot: atom(),
          firmware: String.t() | nil,
          status: :online | :stale | :lost,
          state: atom(),
          mode: String.t() | nil,
          armed: boolean() | nil,
          in_air: boolean() | nil,
          battery: float() | nil,
          voltage: float() | nil,
          fix: integer() | nil,
          satellites: integer() | nil,
          height: number() | nil,
          speed: number() | nil,
          link: 0..100 | nil,
          silent_us: integer() | nil,
          via: String.t() | nil,
          order: [integer() | String.t()],
          on_map: Payload.row() | nil,
          home: [float()] | nil,
          mission: %{total: term(), current: integer() | nil},
          line: term(),
          readiness: :ready | :check | :not_ready | :unknown | nil,
          open: [String.t()],
          problems: [Problems.problem()],
          holder: String.t() | nil,
          tags: [String.t()]
        }

  @doc """
  The row of a snapshot. `links`: snapshots of links; `tags`: the tags of all vehicles by id; `leases`:
  who is in charge, by key; `readiness`: of those that are not armed, by id; `now`: unix microseconds.
  """
  @spec new(
          map(),
          [map()],
          %{String.t() => [String.t()]},
          integer(),
          %{
            Store.vehicle_key() => map()
          },
          %{String.t() => map()}
        ) ::
          t()
  def new(vehicle, links, tags, now, leases \\ %{}, readiness \\ %{}) do
    own = for link <- links, link.id in vehicle.links, do: link
    mode = Snapshot.data(vehicle, :mode)
    battery = Snapshot.data(vehicle, :battery)
    gps = Snapshot.data(vehicle, :gps)
    readiness = if mode[:armed] != true, do: readiness[vehicle.id]
    tags = Map.get(tags, vehicle.id, [])
    problems = Problems.of(vehicle)

    %__MODULE__{
      id: vehicle.id,
      network: vehicle.network,
      system_id: vehicle.system_id,
      kind: vehicle.vehicle_type,
      autopilot: vehicle.autopilot,
      firmware: vehicle.firmware,
      status: vehicle.status,
      state: Payload.state(vehicle),
      mode: text(mode[:mode]),
      armed: mode[:armed],
      in_air: mode[:in_air],
      battery: rounded(battery[:remaining], 2),
      voltage: rounded(battery[:voltage], 1),
      fix: whole(gps[:fix]),
      satellites: whole(gps[:satellites]),
      height: height(Snapshot.data(vehicle, :position)[:alt_rel]),
      speed: rounded(Snapshot.data(vehicle, :velocity)[:groundspeed], 1),
      link: quality(own),
      silent_us: seconds(Snapshot.silent_us(vehicle, own, now)),
      via: vehicle.via,
      order: order(vehicle.id),
      on_map: Payload.row(vehicle, List.first(tags), match?([{:bad, _text} | _more], problems)),
      home: Payload.home(vehicle),
      mission: mission(vehicle, Snapshot.data(vehicle, :mission)),
      readiness: readiness && readiness.state,
      open: open(readiness),
      problems: problems,
      holder: with(%{holder: name} <- leases[vehicle.key], do: name),
      tags: tags
    }
  end

  @doc "The place of an id among others (`:order`)."
  @spec order(String.t()) :: [non_neg_integer() | String.t()]
  # In Erlang numbers sort before texts, so the parts need no tags.
  def order(<<digit, _rest::binary>> = id) when digit in ?0..?9 do
    {number, rest} = Integer.parse(id)
    [number | order(rest)]
  end

  def order(""), do: []

  def order(id) do
    case :binary.match(id, @digits) do
      {at, 1} -> [binary_part(id, 0, at) | order(binary_part(id, at, byte_size(id) - at))]
      :nomatch -> [id]
    end
  end

  defp open(nil), do: []

  defp open(%{points: points}),
    do: for(%{state: state, title: title, text: text} when state != :ready <- points, do: "#{title}: #{text}")

  defp text(mode) when is_binary(mode), do: mode
  defp text(_unknown), do: nil

  # Decimetres matter only near the ground.
  defp height(metres) when is_number(metres) and abs(metres) < 10, do: rounded(metres, 1)
  defp height(metres) when is_number(metres), do: round(metres)
  defp height(_unknown), do: nil

  # 255 means that the receiver does not know the number.
  defp whole(number) when is_integer(number) and number < 255, do: number
  defp whole(_unknown), do: nil

  # Nothing is shown as -0.0.
  defp rounded(value, decimals) when is_number(value), do: Float.round(value / 1, decimals) + 0.0
  defp rounded(_unknown, _decimals), do: nil

  defp quality(links) do
    scores = for %{quality: %{score: score}} when is_number(score) <- links, do: score
    if scores != [], do: scores |> Enum.max() |> round() |> max(0) |> min(100)
  end

  defp mission(vehicle, data) do
    seq = data[:seq]
    %{total: data[:total], current: seq && seq - Firmware.of(vehicle.autopilot).item_offset()}
  end

  defp seconds(nil), do: nil
  defp seconds(us), do: us - rem(us, 1_000_000)
end
