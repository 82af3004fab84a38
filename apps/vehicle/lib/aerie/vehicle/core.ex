defmodule Aerie.Vehicle.Core do
  @moduledoc """
  What a vehicle's session does, without the process: `handle(state, event) -> {state, actions}`.

  Events:

    * `{:frames, link, frames}` - frames of this system, in the order of their arrival, each with its time `at`
    * `{:tick, now}` - it is `now` (unix microseconds) and nothing has come

  Time is the frames' own: a recorded flight played at any speed gives what the flight gave. Before a frame is applied,
  every deadline that lies before its time is dealt with.

  Actions: `{:snapshot, map}` - what the store is to show.
  """

  alias Aerie.Vehicle.Options

  defstruct [:options, :now, :last_heard, status: :online, links: %{}]

  @opaque t :: %__MODULE__{}
  @type event :: {:frames, link :: term(), [struct()]} | {:tick, integer()}
  @type action :: {:snapshot, map()}

  @doc "The state of a vehicle of which nothing is known, or what its snapshot tells."
  @spec new(Options.t(), map() | nil) :: t()
  def new(options, snapshot \\ nil)
  def new(options, nil), do: %__MODULE__{options: options}

  def new(options, snapshot) do
    %__MODULE__{options: options, last_heard: snapshot.last_heard, status: snapshot.status}
  end

  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(state, {:frames, link, frames}) do
    state =
      Enum.reduce(
        frames,
        state,
        &%{&2 | last_heard: &1.at, now: &1.at, links: Map.put(&2.links, link, &1.at)}
      )

    {state, [{:snapshot, snapshot(state)}]}
  end

  def handle(state, {:tick, now}), do: {%{state | now: now}, []}

  @doc "The vehicle as faces see it."
  @spec snapshot(t()) :: map()
  def snapshot(%__MODULE__{options: options} = state) do
    %{
      id: options.id,
      key: options.key,
      network: options.network,
      system_id: options.system_id,
      autopilot: :generic,
      vehicle_type: "unknown",
      firmware: nil,
      status: state.status,
      last_heard: state.last_heard,
      links: Map.keys(state.links),
      groups: %{}
    }
  end
end
