defmodule Aerie.Control.Policy.Store do
  @moduledoc """
  The policy in force at a gateway. Any process reads it without a message and without copying it. It is replaced as a whole
  between two commands; a policy that does not compile leaves the old one in force, and says so in the log, in the audit log and in
  `status/1`.
  """

  use GenServer

  require Logger

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Audit

  @reload_ms 30_000

  @typedoc "Reads the section of the configuration again, or gives a line for everything that is wrong with it."
  @type reader :: (-> {:ok, map()} | {:error, [String.t(), ...]})

  @typedoc """
    * `:since` - when the policy in force was loaded (unix microseconds)
    * `:problem` - why it is not the one of the files: what was wrong with them when they were read last; nil if nothing was
  """
  @type status :: %{since: integer(), problem: nil | %{at: integer(), errors: [String.t(), ...]}}

  @doc "Options: `:gateway`; `:policy`, the first one; `:read`, for `reload/2`."
  @spec start_link(gateway: Names.gateway(), policy: Policy.t(), read: reader() | nil) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :policy))

  @doc "The policy in force; nil for a gateway without one."
  @spec get(Names.gateway()) :: Policy.t() | nil
  def get(gateway), do: :persistent_term.get({__MODULE__, gateway}, nil)

  @doc "Since when the policy is in force, and whether a newer one could not be loaded; nil for a gateway without one."
  @spec status(Names.gateway()) :: status() | nil
  def status(gateway), do: :persistent_term.get({__MODULE__, gateway, :status}, nil)

  @doc """
  Reads the configuration and the fence file again and puts them in force; on errors the old policy stays. `by` is who asked for
  it, for the audit log.
  """
  @spec reload(Names.gateway(), by :: String.t()) :: :ok | {:error, [String.t(), ...]}
  def reload(gateway, by) when is_binary(by), do: call(gateway, {:reload, nil, by})

  @doc "Compiles a section and puts it in force; on errors the old policy stays."
  @spec put(Names.gateway(), map()) :: :ok | {:error, [String.t(), ...]}
  def put(gateway, section), do: call(gateway, {:reload, section, "elixir"})

  defp call(gateway, request) do
    GenServer.call(Names.via(gateway, :policy), request, @reload_ms)
  catch
    :exit, {:noproc, _call} -> {:error, ["the gateway does not run"]}
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:policy, gateway})
    in_force(gateway, Keyword.fetch!(options, :policy))

    {:ok,
     %{
       gateway: gateway,
       read: options[:read] || fn -> {:error, ["the gateway has no configuration file"]} end
     }}
  end

  @impl GenServer
  def handle_call({:reload, section, by}, _from, %{gateway: gateway} = state) do
    result =
      with {:ok, section} <- if(section, do: {:ok, section}, else: state.read.()),
           {:ok, policy} <- Policy.compile(section),
           do: in_force(gateway, policy)

    report(result, gateway, by)
    {:reply, result, state}
  end

  defp in_force(gateway, policy) do
    :persistent_term.put({__MODULE__, gateway}, policy)
    :persistent_term.put({__MODULE__, gateway, :status}, %{since: now(), problem: nil})
  end

  defp report(:ok, gateway, by) do
    Logger.info("policy: reloaded (#{by})")
    Audit.note(gateway, %{"type" => "policy", "loaded" => true, "source" => by})
  end

  defp report({:error, lines}, gateway, by) do
    status = %{status(gateway) | problem: %{at: now(), errors: lines}}
    :persistent_term.put({__MODULE__, gateway, :status}, status)
    since = DateTime.from_unix!(status.since, :microsecond)
    Logger.warning("policy: not loaded (#{by}), that of #{since} stays in force:\n" <> Enum.join(lines, "\n"))

    Audit.note(gateway, %{
      "type" => "policy",
      "loaded" => false,
      "source" => by,
      "reason" => Enum.join(lines, "; ")
    })
  end

  defp now, do: System.os_time(:microsecond)

  # A crash leaves the policy in force: the restart puts it there again.
  @impl GenServer
  def terminate(reason, %{gateway: gateway})
      when reason in [:normal, :shutdown] or elem(reason, 0) == :shutdown do
    for key <- [{__MODULE__, gateway}, {__MODULE__, gateway, :status}], do: :persistent_term.erase(key)
    :ok
  end

  def terminate(_crash, _state), do: :ok
end
