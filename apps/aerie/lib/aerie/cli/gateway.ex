defmodule Aerie.CLI.Gateway do
  @moduledoc "Finds the running gateway that a request is for, and runs the request in it (`Aerie.Node`)."

  alias Aerie.CLI.Subcommand

  # As systemd's "program is not running".
  @none 3

  @doc """
  Runs `module.run(request)` in the gateway, with this VM's standard input and output. It ends when this VM does.
  """
  @spec run(module(), Subcommand.request()) :: {0..255, iodata()} | {:error, String.t()}
  def run(module, request) do
    with {:ok, node, _entry} <- connect(request), do: call(node, module, :run, [request])
  end

  @doc "Calls a function in a gateway, with this VM's standard input and output."
  @spec call(node(), module(), atom(), [term()]) :: term()
  def call(node, module, function, arguments) do
    trap = Process.flag(:trap_exit, true)
    ref = make_ref()
    # Linked, so that it does not outlive us. It inherits our group leader, so what it prints comes here.
    pid = Node.spawn_link(node, __MODULE__, :answer, [self(), ref, module, function, arguments])

    answer =
      receive do
        {^ref, answer} -> answer
        {:EXIT, ^pid, :noconnection} -> {:error, "the gateway has ended"}
        {:EXIT, ^pid, {:undef, _stack}} -> {:error, "the gateway runs another version than this program"}
        {:EXIT, ^pid, reason} -> {:error, "the gateway failed: " <> Exception.format_exit(reason)}
      end

    _ = Process.flag(:trap_exit, trap)
    answer
  end

  @doc false
  @spec answer(pid(), reference(), module(), atom(), [term()]) :: term()
  def answer(to, ref, module, function, arguments), do: send(to, {ref, apply(module, function, arguments)})

  @typedoc "The parts of a request that choose the gateway."
  @type asked :: %{:options => map(), :folder => Path.t(), optional(atom()) => term()}

  @doc "Connects to the gateway of a request."
  @spec connect(asked()) ::
          {:ok, node(), Aerie.Node.Entry.t()} | {0..255, iodata()} | {:error, String.t()}
  def connect(request) do
    dir = dir(request)

    with {:ok, entries} <- Aerie.Node.list(dir),
         {:ok, entry} <-
           choose(entries, request.options[:gateway], place(dir, System.get_env("AERIE_SERVICE_USER"))),
         {:ok, node} <- Aerie.Node.connect(dir, entry),
         do: {:ok, node, entry}
  end

  @doc "The folder of the files of running gateways."
  @spec dir(asked()) :: Path.t()
  def dir(%{options: %{dir: dir}, folder: folder}), do: Path.expand(dir, folder)

  def dir(_request) do
    case System.get_env("AERIE_SHELL_DIR", "") do
      "" -> Path.expand(Aerie.Config.default().shell.dir)
      dir -> Path.expand(dir)
    end
  end

  # `bin/aerie` names the user of an installed service whose files are not ours to read.
  defp place(dir, nil), do: dir
  defp place(dir, user), do: "#{dir}; the service's are for its user: sudo -u #{user} aerie"

  @doc "The gateway that a name means, or the only one; `dir`: where it was looked for. Pure."
  @spec choose([Aerie.Node.Entry.t()], String.t() | nil, String.t()) ::
          {:ok, Aerie.Node.Entry.t()} | {0..255, iodata()} | {:error, String.t()}
  def choose([], _name, dir) do
    {@none,
     "no gateway is running (none has its file in #{dir}); aerie start starts one, --dir names another folder\n"}
  end

  def choose([entry], nil, _dir), do: {:ok, entry}

  def choose(entries, name, _dir) do
    case Enum.find(entries, &(&1.name == name)) do
      nil ->
        lines =
          for e <- entries,
              do:
                "  --gateway #{e.name}   since #{e.started}  #{e.http || "no http"}  #{e.config || "no file"}"

        asked =
          if name,
            do: "no gateway #{name} is running; these are",
            else: "several gateways are running; choose one"

        {:error, Enum.join([asked <> ":" | lines], "\n")}

      entry ->
        {:ok, entry}
    end
  end
end
