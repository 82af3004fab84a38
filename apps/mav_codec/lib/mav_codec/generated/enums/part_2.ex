defmodule MavCodec.Generated.Enums.Part2 do
  use MavCodec.Definition.Shard, enums: {2, 4}
end
