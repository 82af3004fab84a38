defmodule Aerie.CLI.Start do
  @moduledoc """
  `aerie start`, which is `bin/run`: a gateway in this VM.

  `main/1` parses the words (`Aerie.CLI.Parser`, `Aerie.CLI.Start.Options`), plans the run (`Aerie.CLI.Start.Plan`),
  checks the whole configuration, and starts everything below `Aerie.CLI.Supervisor` (`Aerie.CLI.Start.Run`). Nothing is
  left half started: an error ends the program with status 2 and a message that says where the error is and how to
  correct it.
  """

  alias Aerie.CLI.{Help, Output, Parser, Subcommands}
  alias Aerie.CLI.Output.LogKeeper
  alias Aerie.CLI.Start.{ModuleLoader, Options, Plan, Run}

  alias Aerie.Upgrade.Standby

  @doc "Entry point of `bin/run`. Returns once everything is started; the VM runs until it is stopped."
  @spec main([String.t()]) :: :ok
  def main(words) do
    :ok = LogKeeper.take(Output.stdout())

    case call(words, System.get_env(), log: true) do
      :ok -> :ok
      {:finish, text} -> halt(Output.stdout(), text, 0)
      {:fail, text} -> halt(Output.stderr(), text, 2)
    end
  end

  @doc """
  Does what `main/1` does, but does not end the program. Returns `:ok` if a gateway was started, `{:finish, text}` to
  print and end with status 0, or `{:fail, text}` with status 2.

  The environment gives `AERIE_CONFIG` (a configuration file, unless the options name one), `AERIE_CWD` (the user's current directory), `AERIE_TERMINAL` (`yes`: the output is a terminal),
  `AERIE_COLUMNS` and `AERIE_LINES` (its size). `bin/run` sets them, because this program has no standard input that it
  could ask. `options` are those of `Aerie.CLI.Start.Run.start/2`.
  """
  @spec call([String.t()], %{String.t() => String.t()}, keyword()) ::
          :ok | {:finish | :fail, String.t()}
  def call(words, environment, options \\ []) do
    # A release starts it by another name.
    program = environment["AERIE_PROGRAM"] || "bin/run"

    case parse(words) do
      {:ok, parsed} ->
        parsed |> configured(environment) |> start(environment, options)

      {:help, text} ->
        {:finish, String.replace(text, "aerie start", program)}

      :version ->
        {:finish, "aerie #{Application.spec(:aerie, :vsn)}\n"}

      {:error, message} ->
        {:fail, "error: #{String.replace(message, "aerie start", program)}\n"}
    end
  end

  @doc "Parses the words of the command line: options, the text of `--help`, `:version`, or what is wrong."
  @spec parse([String.t()]) :: {:ok, Options.t()} | {:help, String.t()} | :version | {:error, String.t()}
  def parse(words) do
    {:ok, row} = Subcommands.fetch("start")

    case Parser.words(row, words) do
      {:ok, _row, _none, %{version: true}} -> :version
      {:ok, _row, _none, given} -> Options.check(given)
      {:help, row} -> {:help, Help.text(row)}
      {:error, message} -> {:error, String.replace_prefix(message, "start: ", "")}
    end
  end

  defp configured(%{config: nil} = parsed, %{"AERIE_CONFIG" => file}) when file != "",
    do: %{parsed | config: file}

  defp configured(parsed, _environment), do: parsed

  defp start(parsed, environment, options) do
    folder = folder(environment)

    defaults = [
      style: style(parsed, environment),
      size: size(environment),
      device: Output.stdout(),
      warnings: Output.stderr()
    ]

    # A release has none.
    demo? = Code.ensure_loaded?(SimVehicle.Fleet)

    plan = Plan.from(parsed, folder, demo?)

    with :ok <- Standby.wait(environment, &ready(plan, &1)),
         {:ok, _run} <- Run.start(plan, Keyword.merge(defaults, options)) do
      :ok
    else
      {:error, messages} -> {:fail, Enum.map_join(messages, &"error: #{&1}\n")}
    end
  end

  defp ready(plan, ours?), do: with(:ok <- Run.check(plan, ours?), do: ModuleLoader.load_now())

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
    why = if status != 2, do: Output.problem(device)
    if why, do: IO.write(Output.stderr(), "error: #{why}\n")
    System.halt(if(why, do: 2, else: status))
  end
end
