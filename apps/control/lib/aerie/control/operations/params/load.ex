defmodule Aerie.Control.Operations.Params.Load do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Params
  alias Aerie.Vehicle.Command.Error

  @max_bytes 1_048_576

  @impl true
  def operation do
    %Operation{
      name: "params.load",
      meaning: "Sets several parameters, or those of a file.",
      changes?: true,
      fields: [values(), file(), unknown(), no_component()],
      rules: [oneOf: [%{required: [:values]}, %{required: [:file]}]],
      routes: [
        put("/api/vehicles/:id/params", "Sets several parameters of a vehicle.",
          query: [:unknown],
          omit: [:file],
          required: [:values],
          file: :file,
          formats: ~w(json param params txt),
          media: ["text/plain"],
          max_bytes: @max_bytes
        )
      ]
    }
  end

  defp file do
    check = &if(is_binary(&1), do: {:ok, &1}, else: :error)
    meaning = "the text of a parameter file"
    field(:file, {:term, check, meaning}, meaning, schema: %{type: :string})
  end

  defp unknown do
    meaning = "what to do with parameters of a file that the vehicle does not have"
    field(:unknown, {:enum, [:skip, :refuse]}, meaning, default: :refuse)
  end

  # Files have only numbers, as autopilots do. It is named, so that nobody sets the autopilot's instead.
  defp no_component do
    words = "nothing: only the list as JSON and single parameters have it"
    field(:component, {:term, fn _any -> :error end, words}, words, schema: false)
  end

  # The file is read where it is loaded; here is seen that not too many are.
  @impl true
  def prepare(%{file: nil, values: nil}, _format) do
    expected = "an object of names and numbers, or file, the text of a parameter file"
    {:error, [Error.new("values", expected, :missing)]}
  end

  def prepare(%{file: nil} = input, _format), do: {:ok, input}

  def prepare(%{values: %{}}, _format), do: {:error, [Error.new("file", "either values or a file", :rule)]}

  def prepare(input, _format), do: with({:ok, _entries} <- Params.parse(input.file), do: {:ok, input})

  @impl true
  def run(%{file: nil} = input, context),
    do: Params.set_all(context.gateway, context.vehicle, input.values, context.options)

  def run(input, context),
    do: Params.load(context.gateway, context.vehicle, input.file, [unknown: input.unknown] ++ context.options)
end
