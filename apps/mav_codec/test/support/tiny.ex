defmodule MavCodec.Test.Tiny do
  @moduledoc "A dialect of one's own, from XML."
  use MavCodec.Dialect, definitions: "../fixtures/definition/tiny.xml"
end
