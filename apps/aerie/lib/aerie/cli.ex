defmodule Aerie.CLI do
  @moduledoc """
  `bin/aerie`: watches, commands and debugs gateways from a terminal. `Aerie.CLI.Subcommands` lists what it can do,
  `Aerie.CLI.Parser` reads the words, and the modules in `subcommand/` do it: in this VM, or in a running gateway
  (`Aerie.CLI.Gateway`).
  """

  alias Aerie.CLI.Output
  alias Aerie.Base.Printable
  alias Aerie.CLI.{Gateway, Help, Parser, Subcommands}

  @doc "For a release, whose words come after `-extra`."
  @spec main() :: no_return()
  def main do
    {:ok, _started} = Application.ensure_all_started(:elixir)
    :init.get_plain_arguments() |> Enum.map(&List.to_string/1) |> main()
  end

  @doc "Runs the command line, and ends the VM."
  @spec main([String.t()]) :: no_return()
  def main(words) do
    # Log output of libraries must not mix with the answer.
    :ok = :logger.set_primary_config(:level, :error)

    case call(words, System.get_env("AERIE_CWD") || File.cwd!()) do
      {:error, text} ->
        System.halt(failed(text))

      {status, text} ->
        System.halt(print(text) || status)
    end
  end

  @doc "Runs the command line. Returns the exit status and remaining output, or an error."
  @spec call([String.t()], Path.t()) :: {0..255, iodata()} | {:error, String.t()}
  def call(words, folder) do
    case Parser.command_line(words) do
      {:help, row} ->
        {0, Help.text(row)}

      {:ok, row, arguments, options} ->
        request = %{name: row.name, arguments: arguments, options: options, folder: folder}

        if row.where == :gateway,
          do: Gateway.run(row.module, request),
          else: row.module.run(Map.put(request, :rows, Subcommands.all()))

      {:error, text} ->
        {:error, text}
    end
  end

  # The status of an error, nil when it was printed.
  defp print(text) do
    IO.write(Printable.lines(text))
    nil
  rescue
    ErlangError ->
      with {:error, why} <- Output.repeat(Printable.lines(text)),
           do: complain(why),
           else: (_written_or_closed -> nil)
  end

  # Printing may have ended the device, and with it the printing process.
  defp failed(text) do
    IO.write("")
    complain(text)
  rescue
    ErlangError ->
      case Output.repeat("\n") do
        :closed -> 0
        {:error, why} -> complain(why)
        :ok -> complain(text)
      end
  end

  # The exit status also reports it, in case nobody reads the output.
  defp complain(text) do
    IO.puts(:stderr, "error: " <> Printable.lines(text))
    2
  rescue
    _full in [ArgumentError, ErlangError] -> 2
  end
end
