defmodule AerieCLI do
  @moduledoc """
  The command line of Aerie: what `bin/run` starts.

  `main/1` reads the options (`AerieCLI.Options`), plans the run (`AerieCLI.Plan`), checks the configuration as a whole,
  and starts everything below `AerieCLI.Supervisor` (`AerieCLI.Run`). Nothing is half started: an error ends the program
  with status 2 and a line that says where and what to do.
  """

  alias AerieCLI.{Options, Plan, Run}

  @doc "Entry point of `bin/run`. Returns once everything is started; the VM goes on until it is told to end."
  @spec main([String.t()]) :: :ok
  def main(words) do
    case Options.parse(words) do
      {:ok, options} -> start(options)
      :help -> finish(Options.help())
      :version -> finish("aerie #{Application.spec(:aerie_cli, :vsn)}\n")
      {:error, message} -> fail("#{message}\nbin/run --help lists the options")
    end
  end

  defp start(options) do
    folder = System.get_env("AERIE_CWD") || File.cwd!()

    case Run.start(Plan.from(options, folder), style: style(options), size: size()) do
      {:ok, _run} -> :ok
      {:error, messages} -> fail(Enum.join(messages, "\n"))
    end
  end

  # bin/run asks the terminal, because the program itself has no standard input that could tell.
  defp style(%{quiet: true}), do: :lines
  defp style(_options), do: if(System.get_env("AERIE_TERMINAL") == "yes", do: :table, else: :lines)

  defp size, do: {whole("AERIE_COLUMNS", 120), whole("AERIE_LINES", 40)}

  defp whole(name, default) do
    case Integer.parse(System.get_env(name, "")) do
      {number, ""} when number in 10..1000 -> number
      _other -> default
    end
  end

  @spec finish(String.t()) :: no_return()
  defp finish(text) do
    IO.write(text)
    System.stop(0)
    Process.sleep(:infinity)
  end

  @spec fail(String.t()) :: no_return()
  defp fail(message) do
    IO.puts(:stderr, "error: " <> message)
    System.stop(2)
    Process.sleep(:infinity)
  end
end
