defmodule Aerie.Console.Pages.System.Figures do
  @moduledoc "Memory, processor time, the nearest limit of its virtual machine, NATS, versions."

  alias Aerie.Fleet.{Bridge, Health}

  @type t :: %{atom() => term()}

  @doc "The present figures; `before` are the previous ones, to measure from."
  @spec of(Aerie.Base.Names.gateway(), t() | nil) :: t()
  def of(gateway, before) do
    {uptime_ms, _since} = :erlang.statistics(:wall_clock)
    {busy_ms, _since} = :erlang.statistics(:runtime)

    %{
      memory: :erlang.memory(:total),
      uptime_ms: uptime_ms,
      busy_ms: busy_ms,
      cpu: cpu(before, uptime_ms, busy_ms),
      schedulers: :erlang.system_info(:schedulers_online),
      limit: Enum.max_by(limits(), fn {_name, used, most} -> used / most end),
      versions: [
        {"Aerie", version(:console)},
        {"Elixir", System.version()},
        {"OTP", System.otp_release()},
        {"System", os()}
      ],
      nats: Bridge.info(gateway),
      nats_off?: Bridge.off?(gateway),
      identity: Health.heartbeat(gateway)
    }
  end

  # Per cent of one core; 200 is two busy cores.
  defp cpu(%{uptime_ms: then} = before, now, busy) when now > then,
    do: (busy - before.busy_ms) * 100 / (now - then)

  defp cpu(_first, _now, _busy), do: nil

  defp limits do
    for {name, used, most} <- [
          {"processes", :process_count, :process_limit},
          {"ports", :port_count, :port_limit},
          {"atoms", :atom_count, :atom_limit},
          {"ETS tables", :ets_count, :ets_limit}
        ],
        do: {name, :erlang.system_info(used), :erlang.system_info(most)}
  end

  defp version(app) do
    case :application.get_key(app, :vsn) do
      {:ok, version} -> to_string(version)
      :undefined -> "unknown"
    end
  end

  defp os do
    {_family, name} = :os.type()

    version =
      case :os.version() do
        {major, minor, patch} -> "#{major}.#{minor}.#{patch}"
        text -> to_string(text)
      end

    "#{name} #{version}, #{:erlang.system_info(:system_architecture)}"
  end
end
