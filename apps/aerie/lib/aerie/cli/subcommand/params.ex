defmodule Aerie.CLI.Subcommand.Params do
  @moduledoc "`aerie params list`, `get` and `set` (`Aerie.Control.Params`)."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Json
  alias Aerie.Control.Params
  alias Aerie.Control.Params.Table
  alias Aerie.CLI.{Ask, Subcommand}
  alias Aerie.CLI.Output.Columns
  alias MavCodec.Enums.MavParamType

  @impl Aerie.CLI.Subcommand
  def run(%{name: "params list", arguments: %{"VEHICLE" => vehicle} = arguments, options: options}) do
    case Params.list(:default, vehicle, [refresh: options[:refresh] || false] ++ component(options)) do
      {:ok, table} ->
        pattern = String.upcase(arguments["PATTERN"] || "")

        params =
          for param <- Table.plain(table).params,
              String.contains?(String.upcase(param.name), pattern),
              do: param

        {0, if(options[:json], do: [Json.encode_to_iodata!(params), ?\n], else: rows(params))}

      error ->
        Subcommand.Command.answer(error, %{})
    end
  end

  def run(%{name: "params get", arguments: %{"VEHICLE" => vehicle, "NAME" => name}, options: options}) do
    case Params.get(:default, vehicle, name, component(options)) do
      {:ok, param} -> {0, "#{Columns.cell(format(param))}\n"}
      error -> Subcommand.Command.answer(error, %{})
    end
  end

  def run(%{
        name: "params set",
        arguments: %{"VEHICLE" => vehicle, "NAME" => name, "VALUE" => text},
        options: options
      }) do
    with {:ok, value} <- value(text, options[:component]),
         :ok <- Ask.first("set #{name} of #{vehicle} to #{text}", options) do
      Subcommand.Command.answer(
        Params.set(
          :default,
          vehicle,
          name,
          value,
          [as: Subcommand.Command.source(), via: "bin/aerie"] ++ component(options)
        ),
        options
      )
    end
  end

  @doc "All parameters as the text of a file; runs in the gateway."
  @spec file(String.t(), :param | :params) :: {:ok, String.t()} | {0..1, iodata()} | {:error, String.t()}
  def file(vehicle, format) do
    with {:error, _result} = error <- Params.save(:default, vehicle, format),
         do: Subcommand.Command.answer(error, %{})
  end

  defp rows(params),
    do:
      Columns.render(
        ~w(NAME VALUE TYPE DEFAULT),
        for(p <- params, do: [p.name, format(p), MavParamType.label(p.type) || p.type, p.default])
      )

  defp format(param), do: if(param.value == nil, do: "not a number", else: param.value)

  defp component(options), do: for({:component, id} <- Map.take(options, [:component]), do: {:component, id})

  # Only components other than the autopilot have texts; one that is to be a number is refused by the component's type.
  defp value(text, component) do
    case {Integer.parse(text), Float.parse(text)} do
      {{number, ""}, _float} -> {:ok, number}
      {_integer, {number, ""}} -> {:ok, number}
      _other when component != nil -> {:ok, text}
      _other -> {:error, "'#{text}': expected a number"}
    end
  end
end
