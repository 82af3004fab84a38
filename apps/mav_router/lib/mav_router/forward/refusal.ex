defmodule MavRouter.Forward.Refusal do
  @moduledoc """
  What is done about frames that did not reach a vehicle because their sender may not send them there.

  - Orders are counted as `denied` and logged once a minute for each link or client. A COMMAND_LONG or COMMAND_INT is
    answered with DENIED, once a second for each: so a lost answer costs nothing, and an invented sender gains nothing (the answer is
    shorter than the command).
  - Everything else is counted as `withheld`. Messages without a row in the table are logged as well.
  """

  alias MavCodec.Meaning.Messages
  alias MavCodec.Command
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Endpoints.Output
  alias MavRouter.Forward.Reach
  alias MavCodec.Enums.MavResult
  alias MavCodec.Frame
  alias MavCodec.Messages.CommandAck

  require Logger

  @told_ms 60_000
  @answered_ms 1_000
  @denied MavResult.value(:MAV_RESULT_DENIED)

  @doc "A frame was kept from vehicles; `target` is the one that it has."
  @spec withheld(Frame.t(), Delivery.t()) :: :ok
  def withheld(frame, %{path: path} = delivery) do
    if Messages.order?(frame.id) do
      Counters.add(path.counters, :denied, 1)
      answer(frame, Frame.target(frame), delivery)
      report(frame, delivery)
    else
      Counters.add(path.counters, :withheld, 1)
    end
  end

  @doc "Frames to all: what a client or a stranger said, and an order of a vehicle, that did not reach every vehicle."
  @spec of_broadcast([Frame.t()], Delivery.t()) :: :ok
  def of_broadcast(_frames, %{scope: :cleared}), do: :ok
  # It was for nobody else, as is nearly all that a vehicle says.
  def of_broadcast(_frames, %{source: %{vehicles: [], groups: [], heartbeat_receivers: []}}), do: :ok

  # Telemetry of a vehicle is not for other vehicles, which is not worth a line in the log.
  def of_broadcast(frames, %{source: %{vehicle: vehicle?}} = delivery) do
    for frame <- frames,
        not vehicle? or Messages.order?(frame.id),
        refused?(frame, delivery),
        do: withheld(frame, delivery)

    :ok
  end

  defp refused?(frame, %{source: source, scope: scope, forwarding: %{between: between}}) do
    others =
      if source.heartbeat_receivers == [], do: [], else: [if(source.vehicle, do: :vehicle, else: :stranger)]

    relations =
      Enum.map(source.vehicles, &elem(&1, 0)) ++ Enum.map(source.groups, &elem(&1, 1)) ++ others

    Enum.any?(relations, &(scope == :clients or not Reach.passes?(&1, frame, between)))
  end

  @doc "A message without a row came."
  @spec unknown(Frame.t(), Delivery.t()) :: :ok
  def unknown(frame, %{path: path, tables: tables}) do
    if due?(tables, {:unknown, path.owner}, @told_ms) do
      Logger.warning(
        "#{path.owner}: message #{name(frame)} from #{path.text || "a sender"} reached no vehicle, because nothing says what it does; " <>
          "policy.open lets single messages pass"
      )
    end

    :ok
  end

  defp answer(frame, {system, component}, %{path: path, tables: tables}) when system != 0 do
    command = Command.of(frame)

    if command != nil and path.out != nil and due?(tables, {:answered, path.owner}, @answered_ms) do
      ack = %CommandAck{
        command: command,
        result: @denied,
        target_system: frame.system,
        target_component: frame.component
      }

      ids = [system: system, component: max(component, 1), sysid32: true]
      bytes = MavCodec.encode(ack, [version: Frame.version_for(frame, system)] ++ ids)
      Output.bytes(path, bytes, :ack, 1)
    end

    :ok
  end

  defp answer(_frame, _everyone, _delivery), do: :ok

  defp report(frame, %{path: %{owner: owner} = path, source: source, tables: tables}) do
    if due?(tables, {:told, owner}, @told_ms) do
      metadata = %{
        gateway: path.gateway,
        link: owner,
        network: hd(path.networks),
        peer: path.text,
        system: frame.system,
        component: frame.component,
        message: frame.id
      }

      :telemetry.execute([:aerie, :router, :denied], %{frames: 1}, metadata)

      Logger.warning(
        "#{kind(path)} #{owner}: #{path.text || "somebody"} (system #{frame.system}) may not command vehicles by this #{kind(path)}: " <>
          "message #{name(frame)} to #{meant(Frame.target(frame))} was refused. " <> advice(path, source)
      )
    end

    :ok
  end

  defp kind(%{side: :client, auto: false}), do: "client"
  defp kind(_peer_of_a_link), do: "link"

  defp advice(%{side: :client, auto: false}, _source),
    do: "policy.clients gives clients roles and permissions"

  defp advice(_path, %{autopilot: true}),
    do: "It says that it is a vehicle: what it sends still goes to clients"

  defp advice(_path, _source) do
    "If that is your ground station, set gcs: allow for this link, or connect it to one of the clients' endpoints"
  end

  defp name(%{id: id}), do: MavCodec.Dialects.All.name(id) || id

  defp meant(nil), do: "all vehicles"
  defp meant({0, _component}), do: "all vehicles"
  defp meant({system, component}), do: "#{system}/#{component}"

  # One entry for each link and purpose. Two at the same moment may both be due, which only says it twice.
  defp due?(%{settings: settings}, what, every_ms) do
    now = System.monotonic_time(:millisecond)
    key = {__MODULE__, what}
    last = :ets.lookup_element(settings, key, 2, nil)
    (last == nil or now - last >= every_ms) and :ets.insert(settings, {key, now})
  end
end
