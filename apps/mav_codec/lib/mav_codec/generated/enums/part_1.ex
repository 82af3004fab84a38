defmodule MavCodec.Generated.Enums.Part1 do
  use MavCodec.Definition.Shard, enums: {1, 4}
end
