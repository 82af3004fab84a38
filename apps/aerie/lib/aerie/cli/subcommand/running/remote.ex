defmodule Aerie.CLI.Subcommand.Running.Remote do
  @moduledoc """
  `aerie remote`: IEx in the gateway, with `Aerie.Shell`.

  IEx runs on the gateway's node, and so would the halt that it can do at the end of its input. It only stops there; the VM of
  `shell/1` ends `aerie remote`. Without a terminal, use `aerie rpc`.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.Gateway

  @impl Aerie.CLI.Subcommand
  def run(request) do
    with :ok <- terminal(:prim_tty.isatty(:stdin)),
         {:ok, node, _entry} <- Gateway.connect(request),
         {:ok, _started} <- Gateway.call(node, Application, :ensure_all_started, [:iex]),
         file = Gateway.call(node, Application, :app_dir, [:aerie, "priv/shell.exs"]),
         :ok <- :shell.start_interactive({:remote, Atom.to_charlist(node), {__MODULE__, :shell, [file]}}) do
      # It ends when the shell is left.
      Process.sleep(:infinity)
    else
      {:error, reason} when not is_binary(reason) ->
        {:error, "the shell does not start here: #{inspect(reason)}"}

      other ->
        other
    end
  end

  @doc "Whether a shell can be opened. Pure."
  @spec terminal(term()) :: :ok | {:error, String.t()}
  def terminal(true), do: :ok

  def terminal(_pipe_or_file),
    do: {:error, "aerie remote needs a terminal; in a script use aerie rpc, for example: aerie rpc 'fleet()'"}

  @doc "Starts IEx on the gateway's node for the terminal of the caller's node, which ends when IEx does."
  @spec shell(Path.t()) :: pid()
  def shell(file) do
    # The file greets, and imports Aerie.Shell; nothing has to be done before it.
    shell = :iex.start([dot_iex: file, on_eof: :stop_evaluator], {Function, :identity, [:ok]})
    client = node(Process.group_leader())

    _ =
      spawn(fn ->
        monitor = Process.monitor(shell)
        receive(do: ({:DOWN, ^monitor, :process, ^shell, _reason} -> leave(client)))
      end)

    shell
  end

  @doc "Ends the VM of a client, never the gateway's."
  @spec leave(node()) :: :ok
  def leave(client) when client == node(), do: :ok
  def leave(client), do: :erpc.cast(client, :erlang, :halt, [0])
end
