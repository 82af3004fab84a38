defmodule Aerie.CommandCase do
  @moduledoc """
  Tests of commands: a gateway with a policy and the pipeline of commands, and a vehicle of which the test is the executor.
  """
  use ExUnit.CaseTemplate

  import Aerie.GatewayCase, only: [start_gateway: 0]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.{Commands, Policy}
  alias Aerie.LinkCase

  @key {"main", 7}
  @operator %{name: "ops", role: :operator, permissions: []}

  using do
    quote do
      import Aerie.CommandCase
      import Aerie.GatewayCase, only: [eventually: 1]
      alias Aerie.Base.Store
      alias Aerie.Control.{Commands, Ledger, Policy}
      alias Aerie.Vehicle.Command
    end
  end

  @doc """
  Starts a gateway that takes commands, or one for `:gateway`; `policy` and `commands` are those sections of the configuration. Gives its name.
  """
  @spec start_commands(Path.t(), keyword()) :: reference()
  def start_commands(dir, sections \\ []) do
    gateway = Keyword.get_lazy(sections, :gateway, &start_gateway/0)
    audit = %{dir: Path.join(dir, "audit"), max_mb: 8, required: true}

    config = %{
      policy: Map.merge(%{audit: audit}, Map.new(sections[:policy] || [])),
      commands: commands(dir, sections)
    }

    for part <- [Policy.Store.Supervisor, Commands.Supervisor], do: start_part(part, gateway, config)
    Names.register(gateway, :commands, @key)
    put_vehicle(gateway)
    gateway
  end

  @doc "Starts a part of it again, with the same folders."
  @spec start_part(module(), reference(), map()) :: pid()
  def start_part(part, gateway, config) do
    start = {part, :start_link, [LinkCase.options(part, gateway, config)]}
    ExUnit.Callbacks.start_supervised!(%{id: part, start: start, type: :supervisor})
  end

  @doc "The section `commands` with folders below `dir`."
  @spec commands(Path.t(), keyword()) :: map()
  def commands(dir, sections \\ []) do
    ledger = %{dir: Path.join(dir, "ledger"), max_entries: 1000, max_age_s: 3600.0, required: true}
    # A busy machine may stand still for longer than half a second, and than five.
    Map.merge(%{ledger: ledger, urgent_s: 60.0, record_s: 60.0}, Map.new(sections[:commands] || []))
  end

  @doc "The vehicle VID-007 as it is in the store: a copter that stands armed at its home."
  @spec put_vehicle(reference(), map()) :: :ok
  def put_vehicle(gateway, changes \\ %{}) do
    now = System.os_time(:microsecond)
    mode = Map.merge(%{mode: "GUIDED", armed: true, in_air: false}, changes)

    Store.put_vehicle(gateway, @key, %Aerie.Vehicle.Snapshot{
      id: "VID-007",
      key: @key,
      network: "main",
      system_id: 7,
      component: 1,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      status: :online,
      last_heard: now,
      links: [],
      clock: %{rtt_us: 20_000},
      memory: %{sources: %{}, mode_names: %{}},
      groups: %{
        mode: %{at: now, data: mode},
        position: %{at: now, data: %{lat: 47.0, lon: 8.0, alt_rel: 0.0, alt_msl: 500.0, heading: 0.0}},
        home: %{at: now, data: %{lat: 47.0, lon: 8.0, alt_msl: 500.0}}
      }
    })
  end

  @doc "An operator called `ops`."
  @spec operator() :: Policy.Roles.source()
  def operator, do: @operator

  @doc "Submits a command of an operator, in a task."
  @spec command(reference(), String.t(), keyword()) :: Task.t()
  def command(gateway, type, more \\ []) do
    # The longest that there is: on a busy machine ten seconds may not be enough.
    deadline = System.os_time(:second) + 290
    fields = Keyword.merge([vehicle: "VID-007", type: type, as: @operator, deadline: deadline], more)
    Task.async(fn -> Commands.submit(gateway, fields) end)
  end

  @doc "The next command that reaches the executor, and whom to answer; nothing else may come before."
  defmacro executing(pattern) do
    quote do
      assert_receive {:"$gen_call", from, {:submit, unquote(pattern), _progress, _still?}}
      from
    end
  end

  @doc "Fails if a request to carry out a command has reached the executor, whatever else is in the request."
  @spec refute_submitted() :: :ok
  def refute_submitted do
    receive do
      {:"$gen_call", _from, request} when elem(request, 0) == :submit ->
        flunk("submitted: #{inspect(request)}")
    after
      0 -> :ok
    end
  end

  @doc "What the executor says became of a command."
  @spec answer(GenServer.from(), String.t(), atom()) :: :ok
  def answer(from, id, status), do: GenServer.reply(from, Aerie.Vehicle.Command.Result.new(id, status))

  @doc "The records of the audit log; one that is being written is none yet."
  @spec audit(Path.t()) :: [map()]
  def audit(dir) do
    for file <- dir |> Path.join("audit/*.jsonl") |> Path.wildcard() |> Enum.sort(),
        line <- file |> File.read!() |> String.split("\n") |> Enum.drop(-1),
        do: JSON.decode!(line)
  end
end
