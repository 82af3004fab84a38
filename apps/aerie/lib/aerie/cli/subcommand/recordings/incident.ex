defmodule Aerie.CLI.Subcommand.Recordings.Incident do
  @moduledoc "`aerie incident`: one archive of what is known of a vehicle and a time (`Aerie.Incident`)."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.{Gateway, Subcommand}
  alias Aerie.CLI.Output.Columns
  alias Aerie.Config
  alias Aerie.Incident
  alias Aerie.Incident.{Source, Span}
  alias Aerie.Vehicle.Command

  @max_mb 512

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"VEHICLE" => vehicle}, options: options, folder: folder} = request) do
    {:ok, _started} = Application.ensure_all_started(:fleet)
    now = System.os_time(:microsecond)

    with :ok <- name(vehicle),
         {:ok, max_mb} <- max_mb(options[:max_mb] || @max_mb),
         {:ok, span} <- Span.parse(options[:from], options[:to], now),
         {:ok, source} <- source(request) do
      output = Path.expand(options[:output] || Incident.name(vehicle, span) <> ".tar.gz", folder)
      note("#{vehicle}, #{Span.text(span.from)} to #{Span.text(span.to)}")

      made =
        Incident.make(%{
          source: source,
          vehicle: vehicle,
          span: span,
          output: output,
          machine: machine(source.config),
          max_bytes: max_mb * 1_048_576,
          now: now,
          note: &note/1
        })

      with {:ok, bytes, notes} <- made do
        for text <- notes, do: note("not included: #{text}")
        {0, "#{output}: #{bytes} bytes\n"}
      end
    end
  end

  defp name(vehicle) do
    if Command.token?(vehicle),
      do: :ok,
      else: {:error, "'#{vehicle}': a vehicle's name has 1 to 64 letters, digits, - and _"}
  end

  defp max_mb(n) when n in 1..65_536, do: {:ok, n}
  defp max_mb(n), do: {:error, "--max-mb #{n}: expected 1 to 65536"}

  # A configuration means the folders of a gateway, whether it runs or not.
  defp source(%{options: %{config: _file}} = request) do
    case Subcommand.Machine.Config.load(request |> Map.put(:arguments, %{})) do
      {:ok, config} -> {:ok, Source.stopped(config)}
      {:error, errors} -> {:error, Config.format_errors(errors)}
    end
  end

  defp source(request) do
    case Gateway.connect(request) do
      {:ok, node, _entry} ->
        Source.running(&Gateway.call(node, &1, &2, &3))

      {status, text} when is_integer(status) ->
        {status, [text, "--config FILE reads the folders of a stopped one\n"]}

      error ->
        error
    end
  end

  @doc "What is found about the machine, as the archive has it."
  @spec machine(Config.t()) :: [map()]
  def machine(config), do: for(finding <- Subcommand.Machine.Doctor.machine(config), do: text_keys(finding))

  defp text_keys(finding), do: Map.new(finding, fn {key, value} -> {to_string(key), plain(value)} end)

  defp plain(value) when is_atom(value) and not is_nil(value), do: Atom.to_string(value)
  defp plain(value), do: value

  # The archive's path alone goes to standard output.
  defp note(text), do: IO.puts(:stderr, Columns.cell(text))
end
