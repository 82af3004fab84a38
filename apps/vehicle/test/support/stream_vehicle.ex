defmodule Aerie.StreamVehicle do
  @moduledoc """
  A vehicle as far as its streams go, for tests of the arbiter without a clock: it sends messages at the rates that were set
  last, by whoever, obeys or ignores commands, and may be behind a slow link. Time is in ticks of 50 ms.
  """

  alias Aerie.Vehicle.Services.Streams.{Arbiter, Request}
  alias MavCodec.Messages.{CommandLong, RequestDataStream}

  @tick_us 50_000

  defstruct arbiter: nil,
            now: 0,
            rates: %{},
            defaults: %{},
            due: %{},
            knows: :all,
            command: :obeyed,
            acks: true,
            tells: true,
            carried: 1.0,
            loss: 0.0,
            cap: 1000,
            old: true,
            up: true,
            sent: [],
            notices: []

  @doc """
  Options: `rates` (messages per second by id that it begins with), `gateway` (wants of the gateway), `knows` (`:all` or
  ids), `command` (`:obeyed`, `:ignored`, `:unsupported`, `:failed`), `acks`, `tells` (answers MESSAGE_INTERVAL), `old`
  (obeys REQUEST_DATA_STREAM), `carried` (share that the link carries),
  `loss` (share of commands and answers that it loses), `cap` (what its scheduler reaches).
  """
  def new(options \\ []) do
    {gateway, options} = Keyword.pop(options, :gateway, %{})
    defaults = Keyword.get(options, :rates, %{})
    struct!(%__MODULE__{arbiter: Arbiter.new(gateway), defaults: defaults}, options)
  end

  @doc "Lets time pass; `each` is called with the vehicle once a second."
  def run(vehicle, seconds, each \\ & &1) do
    Enum.reduce(1..round(seconds * 20)//1, vehicle, fn n, vehicle ->
      vehicle = tick(vehicle)
      if rem(n, 20) == 0, do: each.(vehicle), else: vehicle
    end)
  end

  @doc "Somebody else sets a rate."
  def set(vehicle, id, hz), do: %{vehicle | rates: Map.put(vehicle.rates, id, hz)}

  @doc "What clients want."
  def want(vehicle, messages, options \\ []) do
    wants = %{messages: messages, groups: Keyword.get(options, :groups, %{})}
    %{vehicle | arbiter: Arbiter.demand(vehicle.arbiter, wants, options[:forwarded])}
  end

  @doc "It begins again, with these rates."
  def reboot(vehicle, rates),
    do: %{
      vehicle
      | rates: rates,
        defaults: rates,
        due: %{},
        arbiter: Arbiter.rebooted(vehicle.arbiter, vehicle.now)
    }

  @doc "What was sent to it, as `{second, what}`, the oldest first."
  def sent(vehicle) do
    for {at, message} <- Enum.reverse(vehicle.sent), do: {at / 1_000_000, words(message)}
  end

  defp words(%CommandLong{command: 511, param1: id, param2: us}), do: {:set, trunc(id), us}
  defp words(%CommandLong{command: 510, param1: id}), do: {:query, trunc(id)}
  defp words(%CommandLong{command: 512, param1: id}), do: {:once, trunc(id)}
  defp words(%RequestDataStream{req_stream_id: id, req_message_rate: hz}), do: {:group, id, hz}

  defp tick(%{up: false} = vehicle), do: %{vehicle | now: vehicle.now + @tick_us}

  defp tick(vehicle) do
    vehicle = speak(%{vehicle | now: vehicle.now + @tick_us})
    {arbiter, messages, notices} = Arbiter.expire(vehicle.arbiter, vehicle.now, {1, 1})
    vehicle = %{vehicle | arbiter: arbiter, notices: vehicle.notices ++ notices}
    Enum.reduce(messages, vehicle, &hear/2)
  end

  defp speak(vehicle) do
    vehicle = %{vehicle | arbiter: Arbiter.received(vehicle.arbiter, "a", 0, vehicle.now)}

    Enum.reduce(vehicle.rates, vehicle, fn {id, hz}, vehicle ->
      speak(vehicle, id, min(hz, vehicle.cap) * vehicle.carried)
    end)
  end

  # Fractions of messages add up until they are one.
  defp speak(vehicle, id, hz) do
    owed = Map.get(vehicle.due, id, 0.0) + hz * @tick_us / 1_000_000
    whole = trunc(owed)

    arbiter =
      Enum.reduce(1..whole//1, vehicle.arbiter, fn _, arbiter ->
        Arbiter.received(arbiter, "a", id, vehicle.now)
      end)

    %{vehicle | arbiter: arbiter, due: Map.put(vehicle.due, id, owed - whole)}
  end

  defp hear(message, vehicle) do
    vehicle = %{vehicle | sent: [{vehicle.now, message} | vehicle.sent]}
    if lost?(vehicle, message), do: vehicle, else: obey(vehicle, message)
  end

  defp lost?(%{loss: loss, now: now}, what), do: :erlang.phash2({now, what}, 1000) < loss * 1000

  defp obey(vehicle, %CommandLong{command: 511, param1: id, param2: us}) do
    id = trunc(id)

    cond do
      vehicle.command == :unsupported -> ack(vehicle, 511, 3)
      vehicle.command == :ignored -> vehicle
      vehicle.command == :failed or not knows?(vehicle, id) -> ack(vehicle, 511, 4)
      us == 0.0 -> vehicle |> set(id, Map.get(vehicle.defaults, id, 0)) |> ack(511, 0)
      true -> vehicle |> set(id, 1_000_000 / us) |> ack(511, 0)
    end
  end

  defp obey(vehicle, %CommandLong{command: 510, param1: id}) do
    id = trunc(id)
    hz = Map.get(vehicle.rates, id, 0)
    interval = if hz > 0, do: round(1_000_000 / hz), else: -1

    if vehicle.tells and not lost?(vehicle, interval) do
      vehicle = ack(vehicle, 510, 0)
      %{vehicle | arbiter: Arbiter.interval(vehicle.arbiter, id, interval, vehicle.now)}
    else
      vehicle
    end
  end

  defp obey(vehicle, %CommandLong{command: 512, param1: id}) do
    vehicle = ack(vehicle, 512, 0)

    if vehicle.acks,
      do: %{vehicle | arbiter: Arbiter.received(vehicle.arbiter, "a", trunc(id), vehicle.now)},
      else: vehicle
  end

  defp obey(%{old: true} = vehicle, %RequestDataStream{req_stream_id: group, req_message_rate: hz}) do
    ids = for id <- Map.get(Request.groups(), group, []), knows?(vehicle, id), do: id
    Enum.reduce(ids, vehicle, &set(&2, &1, hz))
  end

  defp obey(vehicle, _message), do: vehicle

  defp knows?(%{knows: :all}, _id), do: true
  defp knows?(%{knows: ids}, id), do: id in ids

  defp ack(%{acks: false} = vehicle, _command, _result), do: vehicle
  defp ack(vehicle, command, result), do: %{vehicle | arbiter: Arbiter.ack(vehicle.arbiter, command, result)}
end
