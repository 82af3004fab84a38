defmodule Aerie.Vehicle.Session.Core.SnapshotSchedule do
  @moduledoc """
  How often a vehicle's snapshot is written to the store and its deadlines are checked, and what the snapshot shows of
  `Aerie.Vehicle.Session.Core.Services`. A pure value.
  """

  alias Aerie.Vehicle.{Snapshot, State}
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Services.Links.Reception

  # For all vehicles together the store is written a thousand times a second, but for each at least twenty times while that does not
  # exceed four thousand.
  @each_us 1_000
  @longest_us 50_000
  @many_us 250
  # Ten times a second, of more than two hundred vehicles less often: their ticks cost more than what they say.
  @tick_us 100_000
  @longest_tick_us 250_000
  @view_us 400_000
  # How long a collision is shown after its last sign.
  @collision_us 60_000_000

  defstruct at: nil, every_us: @longest_us, view: nil, viewed_at: nil

  @typedoc "`at`: when the last one was written; `every_us`: for how long one stands; `view`: of the services, as of `viewed_at`"
  @type t :: %__MODULE__{
          at: integer() | nil,
          every_us: pos_integer(),
          view: map() | nil,
          viewed_at: integer() | nil
        }
  @type snapshot :: Snapshot.t()

  @doc "The gateway has so many vehicles: the more, the less often each is shown."
  @spec vehicles(t(), non_neg_integer()) :: t()
  def vehicles(shown, n),
    do: %{shown | every_us: (max(n, 1) * @each_us) |> min(@longest_us) |> max(n * @many_us)}

  @doc "The time between two checks of a vehicle's deadlines (microseconds), two of its snapshots."
  @spec tick_us(t()) :: pos_integer()
  def tick_us(%{every_us: every}) when is_integer(every),
    do: (2 * every) |> max(@tick_us) |> min(@longest_tick_us)

  @doc "The next one is due at once."
  @spec due(t()) :: t()
  def due(shown), do: %{shown | at: nil}

  @doc "Whether one is due at `now`."
  @spec due?(t(), integer()) :: boolean()
  def due?(%{at: at, every_us: every}, now), do: at == nil or now - at >= every

  @doc """
  One is written at `now`. `view` gives what it shows of the services, a few times a second: that changes seldom and is as large as
  the rest. It is asked at once after an event or a change of the vehicle's status (`due/1`).
  """
  @spec write(t(), integer(), view :: (-> map())) :: t()
  def write(%{at: last, view: view, viewed_at: at} = shown, now, _view)
      when view != nil and last != nil and now >= at and now - at < @view_us,
      do: %{shown | at: now}

  def write(shown, now, view), do: %{shown | at: now, view: view.(), viewed_at: now}

  @doc "The vehicle as the read model shows it; `view` is what it shows of the services."
  @spec snapshot(Core.t(), view :: map()) :: snapshot()
  def snapshot(%{options: options, state: state} = core, view) do
    %Snapshot{
      id: options.id,
      key: options.key,
      network: options.network,
      system_id: options.system_id,
      component: core.component,
      mavlink_version: core.version,
      autopilot: state.autopilot,
      vehicle_type: state.kind,
      type: state.type,
      firmware: state.firmware,
      uid: state.uid,
      capabilities: state.capabilities,
      status: core.status,
      last_heard: core.last_heard,
      time_boot_ms: state.boot_ms,
      links: Reception.links(core.reception),
      groups: state.groups,
      collision: collision(core),
      streams: view.streams,
      clock: view.clock,
      gcs: view.gcs,
      params: view.params,
      reports: view.reports,
      high_latency: view.high_latency,
      memory: State.memory(state)
    }
  end

  defp collision(%{other_vehicle: %{collision: %{at: at} = collision}, now: now})
       when now - at < @collision_us,
       do: collision

  defp collision(_core), do: nil
end
