defmodule Aerie.CLI.Subcommand.Running.Evaluate do
  @moduledoc "`aerie rpc` and `aerie eval`: Elixir from the command line."
  @behaviour Aerie.CLI.Subcommand

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"EXPRESSION" => text}}) do
    # The compiler's messages belong to the answer, not to the gateway's log.
    case Code.with_diagnostics(fn -> evaluate("import Aerie.Shell, warn: false\n" <> text) end) do
      {{:ok, value}, _warnings} ->
        {0, [inspect(value, pretty: true, limit: 200, printable_limit: 10_000), ?\n]}

      {{:error, text}, []} ->
        {:error, text}

      {{:error, _summary}, remarks} ->
        {:error, Enum.map_join(remarks, "\n", & &1.message)}
    end
  end

  defp evaluate(text) do
    {value, _binding} = Code.eval_string(text, [], file: "expression", line: 0)
    {:ok, value}
  rescue
    error -> {:error, Exception.format(:error, error)}
  catch
    kind, reason -> {:error, Exception.format(kind, reason)}
  end
end
