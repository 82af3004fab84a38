defmodule Aerie.Fleet.Bridge.Events.Gaps do
  @moduledoc """
  Finds events that are missing in a vehicle's row, because a bounded store had to drop them, and makes the marker that a reader gets
  in their place. Pure.

  In one epoch a vehicle's `seq` grows by one from event to event. A marker is an event of the type `events.lost` without a `seq` of
  its own; `data` has the `epoch`, `from`, `to` and their number `lost`. Its id follows from these, so that a marker that is sent
  twice is stored once.
  """

  alias Aerie.Fleet.Bridge.Events.Outbox.Record
  alias Aerie.Base.Json

  @type_name "events.lost"
  @max_vehicles 4096

  defstruct seen: %{}, confirmed: %{}

  @typedoc "The events `first` to `last` of a vehicle in an epoch: one event, or those that a marker stands for."
  @type place ::
          {vehicle :: String.t(), epoch :: pos_integer(), first :: pos_integer(), last :: pos_integer()}
  @type last :: %{String.t() => {epoch :: pos_integer(), seq :: pos_integer()}}
  @type t :: %__MODULE__{seen: last(), confirmed: last()}

  @doc "The type of a marker."
  @spec type() :: String.t()
  def type, do: @type_name

  @doc "How many events are missing at a place."
  @spec size(place() | nil) :: non_neg_integer()
  def size(nil), do: 0
  def size({_vehicle, _epoch, from, to}) when is_integer(from) and is_integer(to), do: to - from + 1

  @doc "The missing ranges, for the log."
  @spec text(place()) :: String.t()
  def text({vehicle, _epoch, from, to}),
    do:
      "events #{from} to #{to} of #{vehicle} are lost: the local stream had no room (nats.streams.event_max_mb)"

  @doc "`confirmed`: the last event of each vehicle that has arrived."
  @spec new(last()) :: t()
  def new(confirmed \\ %{}), do: %__MODULE__{seen: confirmed, confirmed: confirmed}

  @doc "Where an event stands, from its decoded body; nil for one that is in no row."
  @spec place(term()) :: place() | nil
  def place(%{
        "type" => @type_name,
        "vehicle" => vehicle,
        "data" => %{"epoch" => epoch, "from" => from, "to" => to}
      })
      when is_binary(vehicle) and is_integer(epoch) and is_integer(from) and is_integer(to),
      do: {vehicle, epoch, from, to}

  def place(%{"vehicle" => vehicle, "epoch" => epoch, "seq" => seq})
      when is_binary(vehicle) and is_integer(epoch) and is_integer(seq),
      do: {vehicle, epoch, seq, seq}

  def place(_other), do: nil

  @doc """
  The event at a place comes next: what is missing before it, or nil. `whole?`: of a vehicle or an epoch that is not known yet, the
  first event must be number 1.
  """
  @spec observe(t(), place() | nil, boolean()) :: {place() | nil, t()}
  def observe(gaps, nil, _whole?), do: {nil, gaps}

  def observe(gaps, {vehicle, epoch, first, last}, whole?) do
    case gaps.seen do
      %{^vehicle => {^epoch, seq}} ->
        {missing(vehicle, epoch, seq, first), seen(gaps, vehicle, epoch, max(seq, last))}

      %{^vehicle => {newer, _seq}} when newer > epoch ->
        {nil, gaps}

      %{^vehicle => _older} ->
        {missing(vehicle, epoch, 0, first), seen(gaps, vehicle, epoch, last)}

      _unknown when whole? ->
        {missing(vehicle, epoch, 0, first), seen(gaps, vehicle, epoch, last)}

      _unknown ->
        {nil, seen(gaps, vehicle, epoch, last)}
    end
  end

  defp missing(vehicle, epoch, seq, first) when first > seq + 1, do: {vehicle, epoch, seq + 1, first - 1}
  defp missing(_vehicle, _epoch, _seq, _first), do: nil

  defp seen(gaps, vehicle, epoch, seq), do: %{gaps | seen: put(gaps.seen, vehicle, {epoch, seq})}

  @doc "The event at a place has arrived."
  @spec confirm(t(), place() | nil) :: t()
  def confirm(gaps, nil), do: gaps

  def confirm(gaps, {vehicle, epoch, _first, last}) do
    case gaps.confirmed do
      %{^vehicle => known} when known >= {epoch, last} -> gaps
      confirmed -> %{gaps | confirmed: put(confirmed, vehicle, {epoch, last})}
    end
  end

  # Bounded: of a vehicle that falls out, a gap is not noticed.
  defp put(known, vehicle, place) when is_map_key(known, vehicle) or map_size(known) < @max_vehicles,
    do: Map.put(known, vehicle, place)

  defp put(known, vehicle, place) do
    {oldest, _place} = Enum.min_by(known, fn {_vehicle, place} -> place end)
    known |> Map.delete(oldest) |> Map.put(vehicle, place)
  end

  @doc "Starts again after what was confirmed, so that the missing ones are read again."
  @spec reset(t()) :: t()
  def reset(gaps), do: %{gaps | seen: gaps.confirmed}

  @doc "The marker of what is missing; `at` in unix microseconds."
  @spec marker(String.t(), place(), integer()) :: Record.t()
  def marker(environment, {vehicle, epoch, from, to}, at) do
    id = "lost-#{vehicle}-#{epoch}-#{from}-#{to}"

    body = %{
      "id" => id,
      "vehicle" => vehicle,
      "type" => @type_name,
      "epoch" => epoch,
      "seq" => nil,
      "time" => Json.time(at),
      "time_boot_ms" => nil,
      "data" => %{"epoch" => epoch, "from" => from, "to" => to, "lost" => to - from + 1}
    }

    subject = "fleet.#{environment}.#{vehicle}.event.#{@type_name}"
    %Record{id: id, vehicle: vehicle, subject: subject, body: JSON.encode!(body)}
  end
end
