defmodule Aerie.Tool.Run.Remote do
  @moduledoc "`aerie remote`: IEx in the gateway, with `Aerie.Shell`."
  @behaviour Aerie.Tool.Subcommand

  alias Aerie.Tool.Gateway

  @impl Aerie.Tool.Subcommand
  def run(request) do
    with {:ok, node, _entry} <- Gateway.connect(request),
         {:ok, _started} <- Gateway.call(node, Application, :ensure_all_started, [:iex]),
         file = Gateway.call(node, Application, :app_dir, [:aerie, "priv/shell.exs"]),
         :ok <- :shell.start_interactive({:remote, Atom.to_charlist(node), start(file)}) do
      # It ends this VM itself, when the shell is left.
      Process.sleep(:infinity)
    else
      {:error, reason} when not is_binary(reason) ->
        {:error, "the shell does not start here: #{inspect(reason)}"}

      other ->
        other
    end
  end

  # The file greets, and imports Aerie.Shell; nothing has to be done before it.
  defp start(file), do: {:iex, :start, [[dot_iex: file, on_eof: :halt], {Function, :identity, [:ok]}]}
end
