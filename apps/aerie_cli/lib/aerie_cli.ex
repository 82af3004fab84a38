defmodule AerieCLI do
  @moduledoc """
  The command line of Aerie, which `bin/run` starts.

  `main/1` parses the options (`AerieCLI.Options`), plans the run (`AerieCLI.Plan`), checks the whole configuration,
  and starts everything below `AerieCLI.Supervisor` (`AerieCLI.Run`). Nothing is left half started: an error ends the
  program with status 2 and a message that says where the error is and how to correct it.
  """

  alias AerieCLI.{Options, Plan, Run, Vector}

  @doc "Entry point of `bin/run`. Returns once everything is started; the VM runs until it is told to end."
  @spec main([String.t()]) :: :ok
  def main(words) do
    case call(words, System.get_env()) do
      :ok -> :ok
      {:finish, text} -> halt(:stdio, text, 0)
      {:fail, text} -> halt(:stderr, text, 2)
    end
  end

  @doc """
  Does what `main/1` does, but does not end the program. Returns `:ok` if a gateway was started, `{:finish, text}` to
  print and end with status 0, or `{:fail, text}` to end with status 2.

  The environment gives `AERIE_CWD` (the user's current directory), `AERIE_TERMINAL` (`yes`: the output is a terminal),
  `AERIE_COLUMNS` and `AERIE_LINES` (its size). `bin/run` sets them, because this program has no standard input that it
  could ask. `options` are those of `AerieCLI.Run.start/2`.
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
    # No gateway runs, so there is nothing to log; a closed pipe would only log an error.
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
