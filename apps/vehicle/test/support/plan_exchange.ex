defmodule Aerie.PlanExchange do
  @moduledoc """
  A transfer with the mission storage of a simulated firmware, as one pure value: every message goes through the codec, none is lost.
  """

  alias Protocols.Mission.Transfer
  alias MavCodec.Parser
  alias SimVehicle.Plans

  @us {255, 190}
  @vehicle {1, 1}
  @dialect MavCodec.Dialects.All
  @step 1_000
  # More steps than any of these plans takes: a transfer that does not end is a failure.
  @steps 10_000

  @doc "Carries out a transfer: its result, what was sent, and the vehicle's plans."
  def transfer(plans, op, type, protocol, kind \\ "copter") do
    {:ok, transfer} =
      Transfer.new(op, type, protocol: protocol, kind: kind, target: @vehicle, us: @us, until: 60_000_000)

    run(Transfer.handle(transfer, {:start, 0}), plans, [], 0)
  end

  @doc "Plans of a firmware."
  def plans(firmware), do: Plans.new(firmware)

  defp run(_step, _plans, _sent, now) when now > @steps * @step, do: raise("the transfer does not end")

  defp run({transfer, actions}, plans, sent, now) do
    messages = for {:send, message} <- actions, do: on_the_wire(message)
    sent = sent ++ messages

    case List.keyfind(actions, :result, 0) do
      {:result, result} ->
        {result, sent, plans}

      nil ->
        {plans, replies} = Enum.reduce(messages, {plans, []}, &answer(&1, &2, now))
        now = now + @step

        # Nothing came: the transfer waits for a time.
        if replies == [],
          do: transfer |> Transfer.handle({:tick, Transfer.wake_at(transfer)}) |> run(plans, sent, now),
          else: replies |> Enum.reduce({transfer, []}, &hear(&1, &2, now)) |> run(plans, sent, now)
    end
  end

  defp answer(message, {plans, replies}, now) do
    case Plans.handle(plans, message, @us, nil, now) do
      nil -> {plans, replies}
      {plans, more} -> {plans, replies ++ for(reply <- more, is_struct(reply), do: on_the_wire(reply))}
    end
  end

  defp hear(message, {transfer, actions}, now) do
    {transfer, more} = Transfer.handle(transfer, {:message, message, @vehicle, now})
    {transfer, actions ++ more}
  end

  defp on_the_wire(message) do
    bytes = MavCodec.encode(message, system: 1, component: 1, seq: 0, dialect: @dialect)
    {[frame], _parser} = Parser.push_datagram(Parser.new(dialects: [@dialect]), bytes, nil)
    {:ok, message} = MavCodec.decode(frame, @dialect)
    message
  end
end
