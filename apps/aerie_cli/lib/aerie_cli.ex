defmodule AerieCLI do
  @moduledoc """
  The command line of Aerie: what `bin/run` starts.

  `main/1` reads the options (`AerieCLI.Options`), plans the run (`AerieCLI.Plan`), checks the configuration as a whole,
  and starts everything below `AerieCLI.Supervisor` (`AerieCLI.Run`). Nothing is half started: an error ends the program
  with status 2 and a line that says where and what to do.
  """

  alias AerieCLI.{Options, Plan, Run, Vector}

  @doc "Entry point of `bin/run`. Returns once everything is started; the VM goes on until it is told to end."
  @spec main([String.t()]) :: :ok
  def main(words) do
    case call(words, System.get_env()) do
      :ok -> :ok
      {:finish, text} -> halt(:stdio, text, 0)
      {:fail, text} -> halt(:stderr, text, 2)
    end
  end

  @doc """
  What `main/1` does, short of ending the program: `:ok` when a gateway was started, or the text and manner of the end.

  From the environment come `AERIE_CWD` (where the user stands), `AERIE_TERMINAL` (`yes`: the output is a terminal),
  `AERIE_COLUMNS` and `AERIE_LINES` (its size): `bin/run` asks the terminal, because this program has no standard input
  that could tell. `options` are those of `AerieCLI.Run.start/2`.
  """
  @spec call([String.t()], %{String.t() => String.t()}, keyword()) ::
          :ok | {:finish, String.t()} | {:fail, String.t()}
  def call(words, environment, options \\ []) do
    case Options.parse(words) do
      {:ok, parsed} -> start(parsed, environment, options)
      :help -> {:finish, Options.help()}
      :version -> {:finish, "aerie #{Application.spec(:aerie_cli, :vsn)}\n"}
      {:error, message} -> {:fail, "error: #{message}\nbin/run --help lists the options\n"}
    end
  end

  defp start(%{print: [_ | _]} = parsed, environment, options) do
    # Nothing is started whose log would be of interest; that nobody reads any more is no news.
    if options == [], do: :ok = :logger.set_primary_config(:level, :none)

    case Vector.print(parsed, folder(environment), options) do
      :ok -> {:finish, ""}
      {:error, message} -> {:fail, "error: #{message}\n"}
    end
  end

  defp start(parsed, environment, options) do
    folder = folder(environment)
    defaults = [style: style(parsed, environment), size: size(environment)]

    case Run.start(Plan.from(parsed, folder), Keyword.merge(defaults, options)) do
      {:ok, _run} -> :ok
      {:error, messages} -> {:fail, Enum.map_join(messages, &"error: #{&1}\n")}
    end
  end

  defp folder(environment), do: Map.get_lazy(environment, "AERIE_CWD", &File.cwd!/0)

  defp style(%{quiet: true}, _environment), do: :lines
  defp style(_parsed, %{"AERIE_TERMINAL" => "yes"}), do: :table
  defp style(_parsed, _environment), do: :lines

  defp size(environment),
    do: {whole(environment["AERIE_COLUMNS"], 120), whole(environment["AERIE_LINES"], 40)}

  defp whole(nil, default), do: default

  defp whole(text, default) do
    case Integer.parse(text) do
      {number, ""} when number >= 10 and number <= 1000 -> number
      _other -> default
    end
  end

  @spec halt(atom(), String.t(), 0 | 2) :: no_return()
  defp halt(device, text, status) do
    if text != "", do: IO.write(device, text)
    System.halt(status)
  end
end
