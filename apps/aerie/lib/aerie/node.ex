defmodule Aerie.Node do
  @moduledoc """
  The way into a running gateway: Erlang distribution on the loopback address, without epmd, with a cookie that only the gateway's user
  can read. `bin/aerie` uses it for everything that it asks of a gateway, and for the shell.

  A process of a gateway's tree opens the port and writes its file (`Aerie.Node.Entry`); `connect/2` is the other side. Without the
  flags of `rel/vm.args.eex` (in tests, say) nothing is opened. A port that cannot be opened stops no gateway: a warning says so.
  """
  use GenServer

  require Logger

  alias Aerie.Node.{Directory, Entry, Settings}

  @host "127.0.0.1"
  @setup_s 30

  @doc "Options: `:settings`, and `:http` and `:config` for the file."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @doc "Whether this VM was started so that it can open the way in."
  @spec possible?() :: boolean()
  def possible?, do: :init.get_argument(:epmd_module) == {:ok, [[~c"#{Directory}"]]}

  @doc "The gateways that run, by the folder of their files."
  @spec list(Path.t()) :: {:ok, [Entry.t()]} | {:error, String.t()}
  def list(dir) do
    case Entry.list(dir) do
      {:ok, entries} -> {:ok, entries}
      {:error, :enoent} -> {:ok, []}
      {:error, posix} -> {:error, "#{dir}: #{:file.format_error(posix)}; only the gateway's user may read it"}
    end
  end

  @doc "Connects this VM to a gateway. The error is a text."
  @spec connect(Path.t(), Entry.t()) :: {:ok, node()} | {:error, String.t()}
  def connect(dir, entry) do
    with {:ok, cookie} <- cookie(dir),
         :ok <- start("aerie-cli-#{System.pid()}", cookie, false) do
      Directory.put(entry.name, entry.port)
      # The name is that of a file in a folder of the gateway's user.
      node = String.to_atom("#{entry.name}@#{@host}")

      if :net_kernel.connect_node(node),
        do: {:ok, node},
        else:
          {:error,
           "#{entry.name} (process #{entry.pid}) does not let us in on port #{entry.port}: it is ending, or hangs"}
    end
  end

  defp cookie(dir) do
    with {:error, posix} <- Entry.read_cookie(Path.join(dir, "cookie")),
         do: {:error, "#{Path.join(dir, "cookie")}: #{:file.format_error(posix)}"}
  end

  defp start(name, cookie, listen?) do
    Directory.put_cookie(cookie)
    # Both sides give a connection up after so long. The usual seven seconds are too few on a busy machine.
    Application.put_env(:kernel, :net_setuptime, @setup_s)
    options = %{name_domain: :longnames, hidden: true, dist_listen: listen?}

    with {:ok, _pid} <- :net_kernel.start(:"#{name}@#{@host}", options) do
      true = :erlang.set_cookie(cookie)
      :ok
    else
      {:error, {:already_started, _pid}} -> :ok
      {:error, reason} -> {:error, "distribution does not start: #{inspect(reason)}"}
    end
  end

  @impl GenServer
  def init(options) do
    # So that terminate/2 is called.
    Process.flag(:trap_exit, true)
    %Settings{} = settings = options[:settings]
    if settings.enabled and possible?(), do: open(settings.dir, options), else: {:ok, nil}
  end

  defp open(dir, options) do
    name = "aerie-#{System.pid()}"

    with {:ok, cookie} <- Entry.cookie(dir),
         :ok <- start(name, cookie, true),
         :ok <- Entry.write(dir, entry(name, options)) do
      {:ok, {dir, name}}
    else
      {:error, reason} ->
        text = if is_atom(reason), do: "#{dir}: #{:file.format_error(reason)}", else: reason
        Logger.warning("bin/aerie cannot reach this gateway: #{text}")
        {:ok, nil}
    end
  end

  defp entry(name, options) do
    %{
      name: name,
      port: Directory.port(name),
      pid: String.to_integer(System.pid()),
      started: DateTime.to_iso8601(DateTime.utc_now(:millisecond)),
      http: options[:http],
      config: options[:config]
    }
  end

  @impl GenServer
  def terminate(_reason, nil), do: :ok

  def terminate(_reason, {dir, name}) do
    _ = :net_kernel.stop()
    Entry.remove(dir, name)
  end
end
