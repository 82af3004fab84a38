defmodule Aerie.Control.Policy.Mavlink.SystemId do
  @moduledoc """
  A vehicle whose system id is changed by a parameter is another vehicle for the gateway: ArduPilot answers with the new
  id already, PX4 has it after its restart. `follow/4` waits for the new one and names both, by the event
  `system_id.changed`.
  """

  alias Aerie.Base.{Names, PubSub, Store}
  alias Aerie.Vehicle.Events.External
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages.ParamSet

  @names ~w(SYSID_THISMAV MAV_SYSID MAV_SYS_ID)
  # A restart may come later.
  @patience_ms 600_000
  @silent_us 2_000_000
  @look_ms 1_000

  @doc "Whether a parameter is that of the system id."
  @spec param?(String.t()) :: boolean()
  def param?(name), do: name in @names

  @doc "`follow/4` for a message of a client that is passed on."
  @spec sent(Names.gateway(), map() | nil, struct()) :: :ok
  def sent(gateway, %{autopilot: autopilot} = snapshot, %ParamSet{param_id: name} = m) when name in @names do
    encoding = Firmware.traits(autopilot).param_encoding

    with {:ok, value, _exact?} <- ParamValue.decode(m.param_value, m.param_type, encoding),
         do: follow(gateway, snapshot, [{name, value}])

    :ok
  end

  def sent(_gateway, _snapshot, _message), do: :ok

  @doc """
  Waits, in a process of its own, until the vehicle falls silent and another one is heard on its network under the id
  that is among these parameters. `found` gets that one's name. Nothing is waited for if there is no such parameter, or
  a vehicle with this id.
  """
  @spec follow(Names.gateway(), map() | nil, [{String.t(), term()}], (String.t() -> term())) :: :ok
  def follow(gateway, snapshot, params, found \\ fn _name -> :ok end) do
    with %{key: {network, old} = key, id: id} <- snapshot,
         {_name, value} <- Enum.find(params, fn {name, value} -> param?(name) and is_number(value) end),
         system when system in 1..255 and system != old <- trunc(value),
         false <- match?(%{status: :online}, Store.vehicle(gateway, {network, system})),
         true <- Store.claim(gateway, {:system_id, key, system}, @look_ms),
         tasks when tasks != nil <- Names.whereis(gateway, :command_tasks) do
      {:ok, _pid} =
        Task.Supervisor.start_child(tasks, fn ->
          :ok = PubSub.subscribe(gateway, :vehicles)
          wait(gateway, {key, id}, {network, system}, found, now() + @patience_ms)
        end)
    end

    :ok
  end

  defp wait(gateway, {key, id} = old, new, found, until) do
    cond do
      heard?(gateway, new, key) ->
        {_network, system} = new
        %{id: name} = Store.vehicle(gateway, new)
        data = %{"from" => id, "to" => name, "system" => system}

        for which <- [key, new],
            do: External.event(gateway, which, "system_id.changed", data, System.os_time(:microsecond))

        found.(name)

      now() >= until ->
        :ok

      true ->
        receive do
          {:fleet, :vehicles, _ids} -> wait(gateway, old, new, found, until)
        after
          @look_ms -> wait(gateway, old, new, found, until)
        end
    end
  end

  # While the vehicle with the other id is silent.
  defp heard?(gateway, new, old) do
    case {Store.vehicle(gateway, new), Store.vehicle(gateway, old)} do
      {%{status: :online, last_heard: heard}, %{last_heard: last}} when is_integer(last) ->
        heard - last > @silent_us

      {%{status: :online}, nil} ->
        true

      _not_yet ->
        false
    end
  end

  defp now, do: System.monotonic_time(:millisecond)
end
