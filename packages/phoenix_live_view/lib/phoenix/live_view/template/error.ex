defmodule Phoenix.LiveView.Template.Error do
  @moduledoc "An error in a template, with file, line and column."

  defexception [:file, :line, :column, :description]

  @type t :: %__MODULE__{
          file: String.t(),
          line: pos_integer(),
          column: pos_integer(),
          description: String.t()
        }

  @impl Exception
  def message(error),
    do: "#{Path.relative_to_cwd(error.file)}:#{error.line}:#{error.column}: #{error.description}"

  @doc false
  @spec raise!(String.t(), %{line: pos_integer(), column: pos_integer()}, String.t()) :: no_return()
  def raise!(file, meta, description),
    do: raise(__MODULE__, file: file, line: meta.line, column: meta.column, description: description)
end
