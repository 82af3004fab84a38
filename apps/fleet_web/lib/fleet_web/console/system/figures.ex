defmodule FleetWeb.Console.System.Figures do
  @moduledoc "The virtual machine and the gateway's own figures: memory, run queues, limits, versions, NATS."

  alias Aerie.Fleet.Bridge
  alias MavRouter.Identity

  @type t :: %{atom() => term()}

  @doc "The present facts; `before` are the previous ones, to measure from."
  @spec of(Aerie.Base.Names.gateway(), t() | nil) :: t()
  def of(gateway, before) do
    {uptime_ms, _since} = :erlang.statistics(:wall_clock)
    {busy_ms, _since} = :erlang.statistics(:runtime)
    {{:input, input}, {:output, output}} = :erlang.statistics(:io)

    %{
      memory: Map.new(:erlang.memory()),
      uptime_ms: uptime_ms,
      busy_ms: busy_ms,
      # Per cent of one core; 200 is two busy cores.
      cpu:
        before && uptime_ms > before.uptime_ms &&
          (busy_ms - before.busy_ms) * 100 / (uptime_ms - before.uptime_ms),
      io: %{input: input, output: output},
      run_queues: :erlang.statistics(:run_queue_lengths_all),
      schedulers: :erlang.system_info(:schedulers_online),
      limits:
        for {name, used, most} <- [
              {"processes", :process_count, :process_limit},
              {"ports", :port_count, :port_limit},
              {"atoms", :atom_count, :atom_limit},
              {"ETS tables", :ets_count, :ets_limit}
            ] do
          %{name: name, used: :erlang.system_info(used), most: :erlang.system_info(most)}
        end,
      versions: [
        {"Aerie", version(:fleet_web)},
        {"Elixir", System.version()},
        {"OTP", System.otp_release()},
        {"ERTS", to_string(:erlang.system_info(:version))},
        {"Cowboy", version(:cowboy)}
      ],
      os: os(),
      nats: Bridge.info(gateway),
      nats_off?: Bridge.off?(gateway),
      identity: Identity.status(gateway)
    }
  end

  defp version(app) do
    case :application.get_key(app, :vsn) do
      {:ok, version} -> to_string(version)
      :undefined -> "unknown"
    end
  end

  defp os do
    {family, name} = :os.type()

    version =
      case :os.version() do
        {major, minor, patch} -> "#{major}.#{minor}.#{patch}"
        text -> to_string(text)
      end

    "#{name} #{version} (#{family}), #{:erlang.system_info(:system_architecture)}"
  end
end
